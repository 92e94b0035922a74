"""How well textures of people whom the training did not see are rebuilt, beside principal components of the same size.

    python -m benchmarks.handy --count 48

Textures are given as they are, without any picture: what is measured is the space, not how codes are found in pictures.
PSNR and LPIPS are of display values, the former of covered texels, the latter of whole textures.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from handbench.data.openstage.people import look
from handbench.data.openstage.skin import SkinLook, make_skin
from handbench.data.openstage.tattoo import Tattoo
from handbench.hand.openhand import OpenHand
from handbench.methods.handy.generator import LAYERS, SIZE, Generator, shipped
from handbench.metrics.networks import features, network_weights
from handbench.scene.colour import srgb

_FIRST = 20_000  # maintainer/make_handy_generator.py trains on none from here on
_RATE = 5e-2


class Rebuilt(NamedTuple):
    """Per texture (B,): PSNR in dB, LPIPS of two networks."""

    psnr: Tensor
    alex: Tensor
    vgg: Tensor


def person(number: int) -> SkinLook:
    """Someone without tattoos and polish."""
    told = look(number)
    return replace(told, tattoos=(), nails=replace(told.nails, polish=None, tips=False))


def textures(looks: list[SkinLook]) -> Tensor:
    """Display values (B, 3, SIZE, SIZE)."""
    hand = OpenHand.load()
    drawn = [srgb(make_skin(hand, hand.neutral(), each, SIZE).albedo) for each in looks]
    return torch.from_numpy(np.stack(drawn)).permute(0, 3, 1, 2).contiguous()


def covered(made: Generator, drawn: Tensor) -> Tensor:
    """The covered texels (B, 3, N)."""
    return drawn.flatten(2).index_select(2, made.texels)


def projected(made: Generator, true: Tensor, size: int) -> Tensor:
    """The codes (B, K) of the first `size` components, by least squares; the others are zero."""
    basis = made.basis.flatten(1)
    codes = ((covered(made, true) - made.mean).flatten(1) @ basis.T) / basis.square().sum(dim=1)
    return codes * (torch.arange(made.code) < size)


def found(made: Generator, true: Tensor, start: Tensor, steps: int) -> Tensor:
    """The codes that Adam finds from a start, for the least squared error of every texture."""
    codes = start.clone().requires_grad_()
    adam = torch.optim.Adam([codes], _RATE)
    falling = torch.optim.lr_scheduler.CosineAnnealingLR(adam, steps)
    for _ in range(steps):
        adam.zero_grad()
        covered(made, made(codes) - true).square().mean(dim=(1, 2)).log().sum().backward()
        adam.step()
        falling.step()
    return codes.detach()


@torch.no_grad()
def judged(made: Generator, drawn: Tensor, true: Tensor) -> Rebuilt:
    shown = drawn.clamp(0.0, 1.0)
    psnr = -10 * covered(made, shown - true).square().mean(dim=(1, 2)).log10()
    return Rebuilt(psnr, lpips("alex", shown, true), lpips("vgg", shown, true))


def lpips(network: str, drawn: Tensor, true: Tensor) -> Tensor:
    """LPIPS (B,) of display values (B, 3, H, W)."""
    total = torch.zeros(len(true))
    for layer, (one, two) in enumerate(zip(features(network, drawn), features(network, true), strict=True)):
        apart = [part / (part.norm(dim=1, keepdim=True) + 1e-10) for part in (one, two)]
        head = network_weights(f"lpips_{network}")[f"head{layer}.weight"]
        total += (apart[0] - apart[1]).square().mean(dim=(2, 3)) @ head
    return total


def table(made: Generator, looks: list[SkinLook], steps: int) -> None:
    """Prints the rows of people together, and the means of light, medium and dark ones."""
    rows: dict[str, list[Rebuilt]] = {}
    for start in range(0, len(looks), 8):
        true = textures(looks[start : start + 8])
        whole = projected(made, true, made.code)
        drawn = {f"PCA {size}": made.linear(projected(made, true, size)) for size in (16, 32, made.code)}
        drawn["generator, PCA's code"] = made(whole)
        drawn["generator, w"] = made(found(made, true, whole, steps))
        drawn["generator, w+"] = made(found(made, true, whole[:, None].repeat(1, LAYERS, 1), steps))
        for name, each in drawn.items():
            rows.setdefault(name, []).append(judged(made, each, true))
    tone = torch.tensor([each.melanin for each in looks])
    thirds = {"light": tone < 1 / 3, "medium": (tone >= 1 / 3) & (tone < 2 / 3), "dark": tone >= 2 / 3}
    print(f"{'':24}{'PSNR':>8}{'Alex':>8}{'VGG':>8}   PSNR / Alex of " + ", ".join(thirds))
    for name, parts in rows.items():
        psnr, alex, vgg = (torch.cat(values) for values in zip(*parts, strict=True))
        by = "   ".join(f"{float(psnr[some].mean()):.2f} / {float(alex[some].mean()):.4f}" for some in thirds.values())
        print(f"{name:24}{float(psnr.mean()):8.2f}{float(alex.mean()):8.4f}{float(vgg.mean()):8.4f}   {by}")


def limit(made: Generator, looks: list[SkinLook], steps: int) -> None:
    """Prints how far the same people are rebuilt with a tattoo on the back of the hand: where it is, and elsewhere."""
    marked = [replace(each, tattoos=(Tattoo("rose"),)) for each in looks]
    true, bare = textures(marked), textures(looks)
    inked = (covered(made, bare) - covered(made, true)).mean(dim=1) > 0.04
    drawn = made(found(made, true, projected(made, true, made.code), steps))
    error = covered(made, drawn - true).square().mean(dim=1)
    for name, where in (("ink", inked), ("elsewhere", ~inked)):
        left = torch.stack([values[some].mean() for values, some in zip(error, where, strict=True)])
        print(f"tattooed, {name:12}{float((-10 * left.log10()).mean()):8.2f} dB")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.handy", description=__doc__)
    parser.add_argument("--count", type=int, default=48, help="people (default: 48)")
    parser.add_argument("--steps", type=int, default=100, help="of Adam for a texture (default: 100)")
    arguments = parser.parse_args()
    made, start = shipped(), time.process_time()
    looks = [person(_FIRST + i) for i in range(arguments.count)]
    print(f"{arguments.count} unseen people, textures of {SIZE} x {SIZE}, codes of {made.code} numbers")
    table(made, looks, arguments.steps)
    limit(made, looks[:8], arguments.steps)
    print(f"{time.process_time() - start:.0f} s of CPU time")


if __name__ == "__main__":
    main()
