"""What learned methods train on: views with their pictures under known lights, and exact sums of those pictures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import torch
from torch import Tensor

from handbench.errors import Unsupported
from handbench.light.lightset import LightSet, light_samples
from handbench.method import Recording
from handbench.render.see.raster import Raster, rasterise
from handbench.render.uv.posed import CPU, PosedSurface
from handbench.scene import Array, Frame, needed

Shadows: TypeAlias = Literal["hard", "soft", "none"]


@dataclass(frozen=True)
class TrainingView:
    """One pose of a subject in one camera, with L pictures of it, each under some of S single lights.

    directions (D, 3) of the distant ones and positions (P, 3) of the near ones, S = D + P; power (L, S, 3) is the
    irradiance or radiant intensity of each light in each picture, zero where it is off; visible (S, N) says what of
    each reaches the texels, None without shadows. box: rows and columns of the picture in which truth or tracked mesh
    cover a pixel, `covered` how many they cover; images (L, 3, h, w) float16 in that box.
    """

    subject: str
    joints: Tensor
    posed: PosedSurface
    raster: Raster
    centre: Array
    directions: Array
    positions: Array
    power: Array
    visible: Tensor | None
    box: tuple[slice, slice]
    covered: int
    images: Tensor

    def lit_by(self, weights: Array) -> tuple[LightSet, Tensor | None, Tensor]:
        """Lights, visibility and picture (3, h, w) of the weighted sum, weights (L,), of the pictures: light adds."""
        power = np.tensordot(weights, self.power, 1)
        on = power.any(axis=1)
        distant, near = np.split(on, [len(self.directions)])
        irradiance, intensities = np.split(power, [len(self.directions)])
        lights = LightSet(self.directions[distant], irradiance[distant], self.positions[near], intensities[near])
        used = np.flatnonzero(weights)
        scale = torch.from_numpy(weights[used]).float().to(self.images.device)
        picture = torch.einsum("lchw,l->chw", self.images[used].float(), scale)
        return lights, None if self.visible is None else self.visible[np.flatnonzero(on)], picture

    def draw(self, colour: Tensor) -> Tensor:
        """The picture (C, h, w) of texel values (C, N)."""
        atlas = self.posed.atlas
        return self.raster.sample(atlas.dilate(atlas.scatter(colour)))[:, *self.box]


def visibility(posed: PosedSurface, lights: LightSet, shadows: Shadows, texels: Array | None = None) -> Tensor | None:
    """What of each light reaches the covered texels, or some of them, (L + P, N), or None without shadows."""
    return None if shadows == "none" else posed.visibility(lights, soft=shadows == "soft", texels=texels)


def views(
    recording: Recording,
    size: int,
    shadows: Shadows = "hard",
    method: str = "urhand",
    device: torch.device = CPU,
) -> list[TrainingView]:
    """The training views at R x R texels, their tensors on a device, of the recording's single-light and group frames.

    Lights may be distant, near or both. A group frame is left out where the view's single-light frames show all of
    its lights already: their sums say the same, and more. So is a picture without light. Fully lit frames and
    environments are not trained on: the mean texture is made of the former, and neither tells lights apart. Raises
    `Unsupported`, naming `method`, if nothing is left.
    """
    seen: dict[tuple[str, str], list[_Lit]] = {}
    for frame in recording.of_kind("olat", "group").frames:
        lights = light_samples(frame.light)
        if len(lights):
            seen.setdefault((frame.pose_key, frame.camera.name), []).append(_Lit(frame, lights))
    if not seen:
        raise Unsupported(f"{method} trains on single-light or group frames, and the training frames have none")
    surfaces: dict[str, PosedSurface] = {}  # the cameras of a pose share one, and its shadows
    found = []
    for (pose, _), pictures in seen.items():
        if pose not in surfaces:
            surfaces[pose] = PosedSurface(needed(pictures[0].frame.mesh, "mesh"), size, device)
        found.append(_view(_telling(pictures), recording, surfaces[pose], shadows, method))
    return found


@dataclass(frozen=True)
class _Lit:
    """A frame and its light as distant and near ones."""

    frame: Frame
    lights: LightSet

    @property
    def distant(self) -> list[tuple[float, ...]]:
        return [tuple(direction) for direction in self.lights.directions]

    @property
    def near(self) -> list[tuple[float, ...]]:
        return [tuple(position) for position in self.lights.positions]


def _telling(pictures: list[_Lit]) -> list[_Lit]:
    """The pictures of a view without the groups whose lights are all shown one by one."""
    single = [picture for picture in pictures if picture.frame.kind == "olat"]
    distant = {place for picture in single for place in picture.distant}
    near = {place for picture in single for place in picture.near}
    return [
        picture
        for picture in pictures
        if picture.frame.kind == "olat" or not (distant.issuperset(picture.distant) and near.issuperset(picture.near))
    ]


def _view(
    pictures: list[_Lit], recording: Recording, posed: PosedSurface, shadows: Shadows, method: str
) -> TrainingView:
    first = pictures[0].frame
    drawn = rasterise(posed.mesh, first.camera)
    covered = (needed(recording.observe(first).alpha, "alpha") > 0) | (drawn.alpha > 0)
    if not covered.any():
        raise Unsupported(f"{method} trains on pictures of a hand, and {first.key} shows none")
    box = tuple(
        slice(int(np.flatnonzero(side)[0]), int(np.flatnonzero(side)[-1]) + 1)
        for side in (covered.any(1), covered.any(0))
    )
    images = [recording.observe(picture.frame).image[box].transpose(2, 0, 1).astype(np.float16) for picture in pictures]
    directions, irradiance = _different([(p.distant, p.lights.irradiance) for p in pictures])
    positions, intensities = _different([(p.near, p.lights.intensities) for p in pictures])
    single = LightSet(directions, irradiance.sum(axis=0), positions, intensities.sum(axis=0))
    return TrainingView(
        subject=first.subject,
        joints=torch.from_numpy(needed(first.pose, "pose").joints.copy()).float().to(posed.position.device),
        posed=posed,
        raster=drawn,
        centre=first.camera.centre,
        directions=directions,
        positions=positions,
        power=np.concatenate([irradiance, intensities], axis=1),
        visible=visibility(posed, single, shadows),
        box=(box[0], box[1]),
        covered=int(covered.sum()),
        images=torch.from_numpy(np.stack(images)).to(posed.position.device),
    )


def _different(pictures: Sequence[tuple[Iterable[tuple[float, ...]], Array]]) -> tuple[Array, Array]:
    """The different places (S, 3) of all pictures' lights in order of appearance; their power (L, S, 3) in each."""
    places = {place: i for i, place in enumerate(dict.fromkeys(p for some, _ in pictures for p in some))}
    power = np.zeros((len(pictures), len(places), 3))
    for row, (some, values) in zip(power, pictures, strict=True):
        for place, value in zip(some, values, strict=True):
            row[places[place]] += value
    return np.array([*places], dtype=np.float64).reshape(-1, 3), power
