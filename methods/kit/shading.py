"""A posed surface shaded by a reflectance model at the texels that a picture shows of it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from handbench.light.lightset import LightSet
from handbench.render.see.raster import Raster
from handbench.render.shade.cells import CellAnswers
from handbench.render.shade.shading import Model, light_features
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Array
from handbench.skips import note, skips


class Shading:
    """The shading of a posed surface, seen from a point, with hard shadows, light after light.

    position and normal (3, n) are the surface's at its covered texels, float32. If it is made for one picture, only at
    those that its raster looks up (`Skips.unseen`). With `shared` shadows are worked out at all texels, for other
    cameras too, which the surface then keeps.
    """

    def __init__(
        self, surface: PosedSurface, centre: Array, raster: Raster | None = None, shared: bool = False
    ) -> None:
        atlas = surface.atlas
        self._shared = shared
        self._surface, self._centre = surface, centre
        self.position, self.normal = surface.position, surface.normal
        self._cells: dict[tuple[float, Model], CellAnswers] = {}
        self._some: Array | None = None
        if raster is not None and skips().unseen:
            self._some = np.flatnonzero(atlas.needed(raster.texels(atlas.size)))
            self.position, self.normal = (values[:, self._some] for values in (self.position, self.normal))

    @property
    def texels(self) -> Array:
        """Which of the atlas's covered texels are shaded, (n,)."""
        return np.arange(self._surface.atlas.count) if self._some is None else self._some

    def features(
        self, lights: LightSet, roughness: float, model: Model, normal: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Diffuse and specular features (3, n) at the texels under lights; normal (3, n) in place of the surface's."""
        atlas, some = self._surface.atlas, self._some
        note("texels outside charts", atlas.size**2, atlas.size**2 - atlas.count)
        if some is not None:
            note("texels out of sight", atlas.count, atlas.count - len(some))
        rough = torch.full((self.position.shape[1],), roughness)
        if normal is not None:
            maps = normal, self.position, rough, self._centre
            return light_features(*maps, lights, self._visibility(lights), model)
        if (roughness, model) not in self._cells:
            self._cells[roughness, model] = CellAnswers(self.normal, self.position, rough, self._centre, model)
        return self._cells[roughness, model].features(lights, self._visibility)

    def _visibility(self, lights: LightSet) -> Tensor:
        """What of each light reaches the texels, (L + P, n)."""
        if self._some is None or not self._shared:
            return self._surface.visibility(lights, texels=self._some)
        return self._surface.visibility(lights)[:, self._some]

    def texture(self, values: Tensor) -> Tensor:
        """The texture (C, R, R) of values (C, n) at the texels, zero elsewhere."""
        atlas = self._surface.atlas
        if self._some is not None:
            where = torch.from_numpy(self._some)
            values = values.new_zeros(len(values), atlas.count).index_copy(1, where, values)
        return atlas.scatter(values)
