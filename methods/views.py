"""What learned methods train on: views under every stage light, and pictures of any of them together as exact sums."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import torch
from torch import Tensor

from handbench.errors import Unsupported
from handbench.light.lightset import LightSet, light_samples
from handbench.method import Recording
from handbench.render.posed import PosedSurface, raster
from handbench.render.raster import Raster
from handbench.scene import Array, Frame

Shadows: TypeAlias = Literal["hard", "soft", "none"]


@dataclass(frozen=True)
class View:
    """One pose of a subject in one camera, with the pictures under every training light.

    box: rows and columns of the picture in which truth or tracked mesh cover a pixel, `covered` how many they cover;
    images (L, 3, h, w) float16 in that box.
    """

    subject: str
    joints: Tensor
    posed: PosedSurface
    raster: Raster
    centre: Array
    lights: LightSet
    visible: Tensor | None
    box: tuple[slice, slice]
    covered: int
    images: Tensor

    def lit_by(self, weights: Array) -> tuple[LightSet, Tensor | None, Tensor]:
        """Lights, visibility and picture (3, h, w) under weights (L,) of the stage lights: exact sums."""
        used = np.flatnonzero(weights)
        irradiance = self.lights.irradiance[used] * weights[used, None]
        lights = LightSet(self.lights.directions[used], irradiance, self.lights.positions, self.lights.intensities)
        scale = torch.from_numpy(weights[used]).float()
        picture = torch.einsum("lchw,l->chw", self.images[used].float(), scale)
        return lights, None if self.visible is None else self.visible[used], picture

    def draw(self, colour: Tensor) -> Tensor:
        """The picture (C, h, w) of texel values (C, N)."""
        atlas = self.posed.atlas
        return self.raster.sample(atlas.dilate(atlas.scatter(colour)))[:, *self.box]


def visibility(posed: PosedSurface, lights: LightSet, shadows: Shadows) -> Tensor | None:
    """What of each light reaches the texels, (L + P, N), or None without shadows."""
    return None if shadows == "none" else posed.visibility(lights, soft=shadows == "soft")


def views(recording: Recording, size: int, shadows: Shadows = "hard", method: str = "urhand") -> list[View]:
    """The training views at R x R texels; raises `Unsupported` if there are no single-light frames, naming `method`."""
    groups: dict[tuple[str, str], list[Frame]] = {}
    for frame in recording.of_kind("olat").frames:
        groups.setdefault((frame.pose_key, frame.camera.name), []).append(frame)
    if not groups:
        raise Unsupported(f"{method} trains on single-light frames, and the training frames have none")
    return [_view(frames, recording, size, shadows, method) for frames in groups.values()]


def _view(frames: list[Frame], recording: Recording, size: int, shadows: Shadows, method: str) -> View:
    first = frames[0]
    posed = PosedSurface.of(first.mesh, size)
    drawn = raster(first.mesh, first.camera)
    covered = (recording.observe(first).alpha > 0) | (drawn.alpha > 0)
    if not covered.any():
        raise Unsupported(f"{method} trains on pictures of a hand, and {first.key} shows none")
    box = tuple(
        slice(int(np.flatnonzero(side)[0]), int(np.flatnonzero(side)[-1]) + 1)
        for side in (covered.any(1), covered.any(0))
    )
    images = [recording.observe(frame).image[box].transpose(2, 0, 1).astype(np.float16) for frame in frames]
    samples = [light_samples(frame.light) for frame in frames]
    if any(len(sample.directions) != 1 or len(sample.positions) for sample in samples):
        raise Unsupported(f"{method} trains on distant single lights, and {first.key} has another kind of light")
    lights = LightSet(
        np.concatenate([s.directions for s in samples]),
        np.concatenate([s.irradiance for s in samples]),
        np.zeros((0, 3)),
        np.zeros((0, 3)),
    )
    return View(
        subject=first.subject,
        joints=torch.from_numpy(first.pose.joints.copy()).float(),
        posed=posed,
        raster=drawn,
        centre=first.camera.centre,
        lights=lights,
        visible=visibility(posed, lights, shadows),
        box=(box[0], box[1]),
        covered=int(covered.sum()),
        images=torch.from_numpy(np.stack(images)),
    )
