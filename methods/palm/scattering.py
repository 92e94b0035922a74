"""Where light scatters towards a camera: places along rays, with the share that each has in its ray's colour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from .reflectance import Material

if TYPE_CHECKING:
    from .posed import PosedHand, Rendering


LIFT = 5e-4
"""Metres: a mesh with edges of 2 mm is a tenth of a millimetre beside the smooth surface of a finger."""


@dataclass(frozen=True, eq=False)
class Scattering:
    """N places on R rays, in the order of their rays: ray (N) long, and weights (N) that sum to a ray's alpha.

    point (N, 3) in the world, `LIFT` above the surface, where shadow rays start; normal and view (N, 3) unit, view
    towards the camera; material.
    """

    rays: int
    ray: Tensor
    weight: Tensor
    point: Tensor
    normal: Tensor
    view: Tensor
    material: Material

    @staticmethod
    def of(posed: PosedHand, rendering: Rendering) -> Scattering:
        """The places of a march; those below the surface are lifted above it, too."""
        inside = (-rendering.sdf).clamp_min(0.0).detach() + LIFT
        point = rendering.point.detach() + inside[:, None] * rendering.normal.detach()
        parts = (rendering.ray, rendering.weight, point, rendering.normal, -rendering.towards)
        return Scattering(rendering.rays, *parts, rendering.material(posed))

    def total(self, values: Tensor) -> Tensor:
        """Sums (R, C) of weight times values (N, C) by ray."""
        weighted = self.weight[:, None] * values
        return values.new_zeros(self.rays, values.shape[1]).index_add(0, self.ray, weighted)

    def drawn(self, count: int, rng: np.random.Generator | None = None) -> Scattering:
        """`count` places for each ray that is stopped at all, drawn by weight: stratified, at random or in the middle.

        Each has a `count`-th of its ray's alpha. (The released code gives each its interval's weight over the number of
        draws that fell there, which is as much where every interval is met and less where draws are few.) Gradients
        reach the weights as if all places were summed.
        """
        with torch.no_grad():
            weight = self.weight.double()
            alpha = weight.new_zeros(self.rays).index_add(0, self.ray, weight)
            met = torch.nonzero(alpha > 0)[:, 0]
            before = torch.cumsum(alpha, 0) - alpha
            place = torch.full((self.rays, count), 0.5, dtype=torch.float64)
            if rng is not None:
                place = torch.from_numpy(rng.random((self.rays, count)))
            wanted = before[met, None] + alpha[met, None] * (torch.arange(count) + place[met]) / count
            ends = torch.cumsum(weight, 0)
            found = torch.searchsorted(ends, wanted.flatten(), right=True).clamp_max(len(ends) - 1)
            share = (alpha[self.ray[found]] / (count * weight[found])).to(self.weight)
        return self.at(found, self.weight[found] * share)

    def at(self, places: Tensor, weight: Tensor | None = None) -> Scattering:
        """Some of the places (M) long, with other weights (M) if they are given."""
        own = self.weight[places] if weight is None else weight
        vectors = (self.point[places], self.normal[places], self.view[places])
        return Scattering(self.rays, self.ray[places], own, *vectors, self.material.of(places))
