"""Write methods/handy/weights/generator.safetensors: train the generator of skin textures on procedural people.

    python maintainer/make_handy_generator.py --work FOLDER

1. Skins of many people, none of them in any capture, none with tattoos or polish (kept in FOLDER, 50 a file).
2. Their principal components, in display values; every person's code is that of the components, each over its standard
   deviation.
3. Auto-decoding: codes and synthesis together, by how colours and features of a texture differ from the person's.
4. The same with an adversary (`methods/kit/discriminator`): it sees a patch beside what the components alone draw.
5. The first again, slower and with half the weight of features: what the adversary cost in decibels comes back.
6. The mapping network, by the sliced distance between its codes for random z and those of the people.

One core, about half an hour. Started again, it goes on where it was stopped; the same arguments give the same file on
one machine.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save_file
from torch import Tensor, nn

from handbench.checkpoint import checkpoints_in
from handbench.data.openstage.people import look
from handbench.data.openstage.skin import make_skin
from handbench.files import whole
from handbench.hand.openhand import OpenHand
from handbench.method import Progress
from handbench.methods.handy.generator import SIZE, Generator
from handbench.methods.kit.discriminator import Discriminator, discriminator_loss, generator_loss
from handbench.methods.kit.engine import Budget, Player, fit
from handbench.methods.kit.perceptual import patch, perceptual_loss
from handbench.render.uv.atlas import Atlas
from handbench.scene import Array
from handbench.scene.colour import srgb

FOLDER = Path(__file__).resolve().parent.parent / "methods" / "handy" / "weights"
FIRST, UNSEEN = 10_000, 20_000
"""Numbers of the people of the training and of those that nothing here looks at; captures take theirs from 0 on."""

_CHUNK = 50
_CODE = 64
_COLOUR, _FEATURES, _ADVERSARY, _SMALL = 10.0, 0.25, 0.01, 1e-4  # weights of the losses


def skin(hand: OpenHand, person: int) -> Array:
    """The albedo (SIZE, SIZE, 3) float16 of a person without tattoos and polish, display values."""
    told = look(person)
    told = replace(told, tattoos=(), nails=replace(told.nails, polish=None, tips=False))
    return srgb(make_skin(hand, hand.neutral(), told, SIZE).albedo).astype(np.float16)


def skins(folder: Path, first: int, count: int) -> Tensor:
    """Those of `count` people from number `first` on, (count, 3, SIZE, SIZE) float32; made where they are missing."""
    hand = OpenHand.load()
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    for start in range(first, first + count, _CHUNK):
        file = folder / f"{start}.npy"
        if not file.exists():
            made = np.stack([skin(hand, person) for person in range(start, start + _CHUNK)])
            with whole(file) as part, part.open("wb") as opened:
                np.save(opened, made)
            print(f"skins of {start + _CHUNK - first} people", flush=True)
        found.append(torch.from_numpy(np.load(file)))
    return torch.cat(found)[:count].permute(0, 3, 1, 2).float().contiguous()


def components(made: Generator, people: Tensor) -> Tensor:
    """Put the principal components of people (P, 3, SIZE, SIZE) into the generator; their codes (P, K)."""
    flat = people.flatten(2).index_select(2, made.texels)
    mean = flat.mean(dim=0)
    apart = (flat - mean).flatten(1).double()
    _, vectors = torch.linalg.eigh(apart @ apart.T)
    basis = apart.T @ vectors[:, -made.code :].flip(1)
    basis = basis / basis.norm(dim=0)
    basis = basis * torch.where(basis.sum(dim=0) < 0, -1.0, 1.0)
    codes = apart @ basis
    spread = codes.std(dim=0)
    made.mean.copy_(mean)
    made.basis.copy_((basis * spread).T.unflatten(1, mean.shape))
    return (codes / spread).float()


class Decoded(nn.Module):
    """A generator and the code of every person, trained together."""

    def __init__(self, made: Generator, codes: Tensor) -> None:
        super().__init__()
        self.made, self.codes = made, nn.Parameter(codes.clone())
        made.mapping.requires_grad_(False)


class Lesson:
    """The losses on people (P, 3, SIZE, SIZE)."""

    def __init__(self, decoded: Decoded, people: Tensor) -> None:
        self.decoded, self.people = decoded, people
        self.judge = Discriminator(conditions=3)
        self._drawn: dict[str, Tensor] = {}
        with torch.no_grad():  # decibels are what counts: an error weighs as much as the components leave of a person
            drawn = [decoded.made.linear(code[None])[0] for code in decoded.codes]
            left = torch.stack([(a - b).square().mean().sqrt() for a, b in zip(drawn, people, strict=True)])
        self._weight = left.mean() / left

    def plain(self, person: int, rng: np.random.Generator) -> Mapping[str, Tensor]:
        """Colours and features of a person's texture."""
        code, true = self.decoded.codes[person : person + 1], self.people[person]
        drawn = self.decoded.made(code)
        where = patch(SIZE, SIZE, rng)
        self._drawn = {
            "fake": drawn[:, :, *where],
            "real": true[None, :, *where],
            "beside": self.decoded.made.linear(code.detach())[:, :, *where],
        }
        off = drawn[0] - true
        return {
            "colour": _COLOUR * self._weight[person] * (off.abs().mean() + 5.0 * off.square().mean()),
            "features": _FEATURES * perceptual_loss(drawn[:, :, *where], true[:, *where])[0],
            "small": _SMALL * code.square().sum(),
        }

    def settling(self, person: int, rng: np.random.Generator) -> Mapping[str, Tensor]:
        """Colours and, by half, features."""
        terms = dict(self.plain(person, rng))
        return terms | {"features": 0.5 * terms["features"]}

    def adversarial(self, person: int, rng: np.random.Generator) -> Mapping[str, Tensor]:
        """The same, and what the adversary says of a patch."""
        terms = dict(self.plain(person, rng))
        scores = self.judge(self._drawn["fake"], self._drawn["beside"])
        return terms | {"adversary": _ADVERSARY * generator_loss(scores)}

    def judged(self, person: int, rng: np.random.Generator) -> Mapping[str, Tensor]:
        """What the adversary itself minimises, on the patch that the generator just drew."""
        real, fake, beside = (self._drawn[name].detach() for name in ("real", "fake", "beside"))
        return {"hinge": discriminator_loss(self.judge(real, beside), self.judge(fake, beside))}


def mapped(made: Generator, codes: Tensor, steps: int) -> None:
    """Train the mapping network: along random directions its codes are distributed as the people's (P, K) are."""
    generator = torch.Generator().manual_seed(3)
    made.mapping.requires_grad_(True)
    adam = torch.optim.Adam(made.mapping.parameters(), 2e-3)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps)
    for _ in range(steps):
        chosen = codes[torch.randperm(len(codes), generator=generator)[:512]]
        drawn = made.map(torch.randn(chosen.shape, generator=generator))
        way = torch.nn.functional.normalize(torch.randn(made.code, 128, generator=generator), dim=0)
        loss = ((drawn @ way).sort(dim=0)[0] - (chosen @ way).sort(dim=0)[0]).square().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
        falling.step()
    print(f"mapping: sliced distance {float(loss.detach()):.4f}")


def told(name: str) -> Progress:
    """Prints losses of a training now and then."""

    def progress(step: int, total: int, **values: float) -> None:
        if step % 100 == 0 or step == total:
            print(name, f"{step}/{total}", " ".join(f"{k} {v:.4f}" for k, v in values.items()), flush=True)

    return progress


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--work", type=Path, required=True, help="folder for skins and checkpoints")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder to write into (default: the package's)")
    parser.add_argument("--people", type=int, default=1600)
    parser.add_argument("--steps", type=int, nargs=3, default=(4000, 1500, 1000), help="of 3., 4. and 5.")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(1)
    people = skins(arguments.work / "skins", FIRST, arguments.people)
    atlas = Atlas.of(OpenHand.load().topology(1), SIZE)
    made = Generator(_CODE, torch.from_numpy(atlas.texels))
    decoded = Decoded(made, components(made, people))
    lesson = Lesson(decoded, people)
    first, second, third = arguments.steps
    with checkpoints_in(arguments.work / "-".join(map(str, ("training", arguments.people, *arguments.steps)))):
        plain = Budget(first, 4, (2e-3, 4e-4), 50, (0.5, 0.99))
        fit("decoding", [Player("decoder", decoded, lesson.plain)], len(people), plain, 1, told("decoding"))
        both = [Player("decoder", decoded, lesson.adversarial), Player("judge", lesson.judge, lesson.judged)]
        fit("adversary", both, len(people), Budget(second, 4, (4e-4, 1e-4), 50, (0.5, 0.99)), 2, told("adversary"))
        slow = Budget(third, 4, (3e-4, 2e-5), 50, (0.5, 0.99))
        fit("settling", [Player("decoder", decoded, lesson.settling)], len(people), slow, 3, told("settling"))
    mapped(made, decoded.codes.detach(), 1500)
    state = {name: v.half() if v.is_floating_point() else v for name, v in made.state_dict().items()}
    about = {
        "people": arguments.people,
        "steps": arguments.steps,
        "first": FIRST,
        "trained": "here, on procedural skins",
    }
    target = arguments.out / "generator.safetensors"
    with whole(target) as part:
        save_file({name: v.contiguous() for name, v in state.items()}, part, {"handbench": json.dumps(about)})
    print(f"{target}: {target.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
