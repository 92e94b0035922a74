"""What a known pose answers to the cells of environments: from the second environment on, light is a matrix product."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from ...light.lightset import LightSet
from ...scene import Array
from ...skips import note, skips
from .models import Model
from .shading import light_features, relight, transfer


class CellAnswers:
    """N texels of one material, seen from one point, under light after light.

    Environments share most of their lights, the cells of the sphere (`LightSet.coarse`), and only the power of these
    differs. What each texel answers to each cell is worked out once a second environment comes (`Skips.known`), as it
    takes 8 N bytes a cell, and a little longer than to light a texel by all of them.
    """

    def __init__(self, normal: Tensor, position: Tensor, roughness: Tensor, centre: Array, model: Model) -> None:
        self._maps = normal, position, roughness, centre
        self._model = model
        self._lit = False  # by an environment
        self._row: dict[bytes, int] = {}
        self._kept: Tensor | None = None

    @torch.no_grad()
    def features(self, lights: LightSet, visibility: Callable[[LightSet], Tensor | None]) -> tuple[Tensor, Tensor]:
        """`light_features` (3, N) each under lights of which `visibility` says what reaches the texels, (L + P, N)."""
        cells = lights.coarse if skips().known else None
        environment = cells is not None and bool(cells.any())
        again, self._lit = self._lit and environment, self._lit or environment
        if cells is None or not again:
            return light_features(*self._maps, lights, visibility(lights), self._model)
        of_cells, others = lights.only(cells, np.zeros(len(lights.positions), dtype=bool)), lights.only(~cells)
        diffuse, specular = self._by_cells(of_cells, visibility)
        if not len(others):
            return diffuse, specular
        rest = light_features(*self._maps, others, visibility(others), self._model)
        return diffuse + rest[0], specular + rest[1]

    def _by_cells(self, cells: LightSet, visibility: Callable[[LightSet], Tensor | None]) -> tuple[Tensor, Tensor]:
        names = [row.tobytes() for row in cells.directions]
        first = {name: place for place, name in reversed(list(enumerate(names))) if name not in self._row}
        new = np.zeros(len(names), dtype=bool)
        new[list(first.values())] = True  # a group may hold two environments, and each cell twice
        if first:
            fresh = cells.only(new)
            found = transfer(*self._maps, fresh.directions, visibility(fresh), self._model)
            self._kept = found if self._kept is None else torch.cat([self._kept, found], dim=1)
            for place in np.flatnonzero(new):
                self._row[names[place]] = len(self._row)
        assert self._kept is not None
        power = np.zeros((len(self._row), 3))
        np.add.at(power, [self._row[name] for name in names], cells.irradiance)
        texels = self._kept.shape[2]
        note("texel-light pairs", len(names) * texels, (len(names) - len(first)) * texels)
        return relight(self._kept, power)
