"""What taking the light out of phone scans leaves of the skin: `python -m benchmarks.bleaching`.

Albedo recovered from the scans of openphone against the one they were drawn with, after the best factor in each
channel (pictures tell only light times albedo): PSNR of display values over the peak, person by person, palm and back
apart, and the contrast of palm to back. Hands are posed as they were: errors are those of taking the light out.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
import torch

from handbench.data.openstage import open_capture
from handbench.data.openstage.population import cast
from handbench.data.openstage.skin import make_skin
from handbench.hand import hand_model
from handbench.hand.openhand import OpenHand
from handbench.hand.twins import palm
from handbench.methods.kit.fittedhand import FittedHand, Sighting
from handbench.methods.phone.joint import decomposed
from handbench.methods.phone.shadow import shadow
from handbench.methods.phone.unwrap import Unwrapped, unwrapped
from handbench.recording import Recording
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Array
from handbench.scene.colour import srgb

LEVEL, SIZE = 1, 128
WEIGHTS = (1.0, 10.0, 100.0, 1e3, 1e4)
"""Of the shadow's squared variation, for textures of 1024 x 1024; 100 is the preset's."""


def recovered(found: Unwrapped) -> Iterator[tuple[str, Array]]:
    """The texture (3, N) that each way leaves, by its name."""
    yield "as unwrapped", found.mean
    for most in (None, 1.0):
        for weight in WEIGHTS:
            blur = weight * (SIZE / 1024) ** 2
            dark = shadow(found.mean, found.seen, found.foreground, found.atlas, blur, most)
            yield f"seed's shadow{', at most 1' if most else ''}, weight {weight:g}", found.mean / dark
    yield "SH light and albedo", decomposed(found.pictures, found.mean, found.foreground).colour


def psnr(texture: Array, albedo: Array) -> float:
    """Of two textures (3, n), in display values of the albedo's scale."""
    factor = (texture * albedo).sum(axis=1) / (texture**2).sum(axis=1)
    error = srgb(np.maximum(texture * factor[:, None], 0.0)) - srgb(albedo)
    return float(-10.0 * np.log10((error**2).mean()))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bleaching", description=__doc__)
    parser.add_argument("--size", default="quick", help="of openphone (default: quick)")
    arguments = parser.parse_args()
    source, hand = open_capture(arguments.size, capture="openphone"), hand_model()
    surface = PosedSurface(hand.mesh(hand.neutral(), hand.named_pose("rest"), LEVEL), SIZE)
    facing = -palm(hand) @ surface.normal.numpy() / np.linalg.norm(palm(hand))
    count = len({frame.subject for frame in source.frames()})
    for person in cast("openphone", count, OpenHand.load()):
        frames = [f for f in source.frames() if f.subject == person.name and f.segment == "scan"]
        truths = [source.truth(frame) for frame in frames]
        sightings = tuple(Sighting(f, t.pose) for f, t in zip(frames, truths, strict=True) if t.pose is not None)
        exact = FittedHand(hand, np.asarray(truths[0].shape), LEVEL, sightings)
        found = unwrapped(exact, Recording(frames, source.observe), SIZE)
        skin = make_skin(OpenHand.load(), person.identity, person.look, 2 * SIZE)
        small = skin.albedo.reshape(SIZE, 2, SIZE, 2, 3).mean(axis=(1, 3))
        albedo = surface.atlas.gather(torch.from_numpy(np.moveaxis(small, -1, 0).copy())).double().numpy()
        parts = {"all": found.seen, "palm": found.seen & (facing > 0.3), "back": found.seen & (facing < -0.3)}
        contrast = _contrast(albedo, parts)
        tattooed = ", tattooed" if person.look.tattoos else ""
        print(f"\n{person.name}: melanin {person.look.melanin:.2f}{tattooed}; palm to back {contrast:.2f}")
        print(f"{'':36}{'all':>8}{'palm':>8}{'back':>8}  contrast, of the true one")
        for name, texture in recovered(found):
            scores = "".join(f"{psnr(texture[:, part], albedo[:, part]):8.1f}" for part in parts.values())
            print(f"{name:36}{scores}{_contrast(texture, parts) / contrast:10.2f}", flush=True)


def _contrast(texture: Array, parts: dict[str, Array]) -> float:
    """How much lighter the palm is than the back, in the mean of the three channels."""
    palm, back = (float(texture[:, parts[name]].mean()) for name in ("palm", "back"))
    return palm / back


if __name__ == "__main__":
    main()
