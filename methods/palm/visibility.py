"""What a hand hides from its own places: by a mesh of it, or by marching its density.

The released march is body-scale: 64 samples over 1.5 m are steps of 24 mm, thicker than a finger, and miss a quarter of
what is hidden on a hand; the same 64 over 0.3 m miss 1 to 2 %. So `HAND_SCALE` is what everything but the preset
"released" uses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from handbench.errors import InputError
from handbench.render.see.posedmesh import PosedMesh
from handbench.scene import Array


@dataclass(frozen=True)
class March:
    """A secondary ray: `samples` from `near` to `far` metres. Raises `InputError` for what is no march."""

    samples: int = 64
    near: float = 2e-3
    far: float = 0.3

    def __post_init__(self) -> None:
        if self.samples < 1 or not 0.0 <= self.near < self.far:
            raise InputError(
                f"secondary rays: {self.samples} samples from {self.near} to {self.far} m are no march; give at least "
                "1 sample and 0 <= near < far"
            )


HAND_SCALE = March()
BODY_SCALE = March(64, 0.0, 1.5)
"""The released one."""


class Occluder(Protocol):
    """How much light comes through, 0 to 1, to points that are off the surface."""

    def __call__(self, points: Tensor, towards: Tensor) -> Tensor:
        """How much of the light from unit directions (N, 3) reaches points (N, 3): (N)."""
        ...

    def of_all(self, points: Tensor, normal: Tensor, towards: Tensor) -> Tensor:
        """The same of all pairs of points (P, 3) and directions (D, 3) above the horizon, (P, D); 0 for others."""
        ...

    def of_near(self, points: Tensor, position: Array) -> Tensor:
        """How much of the light at a position (3,) reaches points (N, 3): (N)."""
        ...


class MeshOccluder:
    """Hard shadows of a triangle mesh (Embree)."""

    def __init__(self, mesh: PosedMesh) -> None:
        self._scene = mesh.rays

    def __call__(self, points: Tensor, towards: Tensor) -> Tensor:
        return torch.from_numpy(~self._scene.occluded(points.double().numpy(), towards.numpy())).float()

    def of_all(self, points: Tensor, normal: Tensor, towards: Tensor) -> Tensor:
        above = normal @ towards.T > 0
        place, direction = torch.nonzero(above, as_tuple=True)
        rays = np.empty((len(place), 6), dtype=np.float32)
        start = (points.double() - torch.from_numpy(self._scene.centre)).float()
        rays[:, :3], rays[:, 3:] = start[place].numpy(), towards.float()[direction].numpy()
        seen = torch.zeros(above.shape)
        seen[above] = torch.from_numpy(~self._scene.blocked(rays)).float()
        return seen

    def of_near(self, points: Tensor, position: Array) -> Tensor:
        place = points.double().numpy()
        return torch.from_numpy(~self._scene.occluded(place, position - place, far=1.0)).float()


@dataclass(frozen=True, eq=False)
class MovedOccluder:
    """An occluder where something rigid was, asked from where it is: places go back by x -> turn x + offset."""

    inner: Occluder
    turn: Tensor
    offset: Tensor

    def __call__(self, points: Tensor, towards: Tensor) -> Tensor:
        return self.inner(points @ self.turn.T + self.offset, towards @ self.turn.T)

    def of_all(self, points: Tensor, normal: Tensor, towards: Tensor) -> Tensor:
        back = (points @ self.turn.T + self.offset, normal @ self.turn.T, towards @ self.turn.T)
        return self.inner.of_all(*back)

    def of_near(self, points: Tensor, position: Array) -> Tensor:
        place = self.turn.double() @ torch.from_numpy(position) + self.offset
        return self.inner.of_near(points @ self.turn.T + self.offset, place.numpy())


class DensityOccluder:
    """Soft shadows of a volume: the transmittance along a march of its density (N, 3) -> (N), per metre."""

    def __init__(self, density: Callable[[Tensor], Tensor], march: March = HAND_SCALE) -> None:
        self._density, self.march = density, march

    @torch.no_grad()
    def __call__(self, points: Tensor, towards: Tensor) -> Tensor:
        march = self.march
        step = (march.far - march.near) / march.samples
        away = march.near + step * (torch.arange(march.samples).to(points) + 0.5)
        along = points[:, None] + away[:, None] * towards[:, None]
        density = self._density(along.reshape(-1, 3)).reshape(along.shape[:2])
        return torch.exp(-step * density.sum(dim=1))

    def of_all(self, points: Tensor, normal: Tensor, towards: Tensor) -> Tensor:
        seen = torch.zeros(len(points), len(towards))
        for column, direction in enumerate(towards):
            above = normal @ direction > 0
            seen[above, column] = self(points[above], direction.expand(int(above.sum()), 3))
        return seen

    def of_near(self, points: Tensor, position: Array) -> Tensor:
        """As if the light were distant: within a march's length of a hand there is none."""
        away = torch.from_numpy(position).to(points) - points
        return self(points, torch.nn.functional.normalize(away, dim=1))
