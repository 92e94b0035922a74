"""The lighting core at one configuration: a picture of a new pose, and of a known one under any map."""

from __future__ import annotations

from contextlib import AbstractContextManager
from copy import copy
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...light.environment import solid_angles, to_directional
from ...light.lightset import LightSet
from ...light.reduction import reduced
from ...render.see.posedmesh import PosedMesh
from ...render.see.raster import Raster, rasterise
from ...render.see.shadowmap import soft_visibility
from ...render.see.visibility import visibility
from ...render.shade.shading import Model, light_features, relight, transfer
from ...render.uv.atlas import Atlas
from ...scene import Array, Environment, Mesh
from ...skips import NONE, Skips, skipping
from .configurations import Configuration
from .scene import Scene

_SPLIT = 8
"""Parts along a texel's side that clustering may tell apart: a bright texel becomes several lights."""

_AT_ONCE = 512
"""Directions whose transfer is worked out at once."""


class Core:
    """Draws a scene at a configuration. What does not depend on the pose, the lights and the atlas, is made here."""

    def __init__(self, scene: Scene, configuration: Configuration) -> None:
        self.scene, self.configuration = scene, configuration
        self.lights = lights_of(scene.environment, configuration)
        self.atlas = Atlas.of(scene.mesh.topology, configuration.texture)
        self._dtype: torch.dtype = getattr(torch, configuration.precision)
        self._albedo = torch.from_numpy(scene.albedo / np.pi)[:, None]

    @torch.no_grad()
    def new_pose(self, mesh: Mesh) -> Array:
        """The picture (H, W, 3) of a mesh of which nothing is kept."""
        with self._skips():
            posed = PosedMesh(mesh)
            raster = rasterise(posed, self.scene.camera, self.configuration.supersample)
            some, texels = self._seen(raster)
            position, normal = (self._at(some, values) for values in (posed.vertices, posed.normals))
            rough, seen = self._roughness(some), self._visibility(posed, some, self.lights.directions)
            model: Model = "diffuse" if self.scene.roughness is None else "brdf"
            centre = self.scene.camera.centre
            return self._drawn(
                raster, texels, *light_features(normal, position, rough, centre, self.lights, seen, model)
            )

    @torch.no_grad()
    def learn(self, mesh: Mesh) -> KnownPose:
        """What is kept of a pose: raster, texels and their transfer from the texels of the scene's map."""
        with self._skips():
            posed = PosedMesh(mesh)
            raster = rasterise(posed, self.scene.camera, self.configuration.supersample)
            some, texels = self._seen(raster)
            position, normal = (self._at(some, values) for values in (posed.vertices, posed.normals))
            rough = self._roughness(some)
            centre, directions = self.scene.camera.centre, self.lights.directions
            owner, shares = _owners(self.configuration, self.scene.environment)
            kept = normal.new_zeros(2, int(owner.max()) + 1, some.count)
            for first in range(0, len(directions), _AT_ONCE):
                part = slice(first, first + _AT_ONCE)
                seen = self._visibility(posed, some, directions[part])
                if seen is None:
                    seen = torch.ones(len(directions[part]), some.count, dtype=torch.bool)
                found = transfer(normal, position, rough, centre, directions[part], seen)
                kept.index_add_(1, torch.from_numpy(owner[part]), found * _column(shares[part], found))
            self._drawn(raster, texels, *kept[:, :3])  # the raster's lookup table is kept as well
        return KnownPose(self, raster, texels, kept if self.scene.roughness is not None else kept[:1].contiguous())

    def _skips(self) -> AbstractContextManager[None]:
        return skipping(Skips() if self.configuration.skips else NONE)

    def _seen(self, raster: Raster) -> tuple[Atlas, Tensor | None]:
        """The atlas of the texels that the picture looks up, and their places among the covered ones."""
        if not self.configuration.skips:
            return self.atlas, None
        texels = np.flatnonzero(self.atlas.needed(raster.texels(self.configuration.texture)))
        some = copy(self.atlas)
        some.texels, some.face, some.barycentric = (
            values[texels] for values in (self.atlas.texels, self.atlas.face, self.atlas.barycentric)
        )
        return some, torch.from_numpy(texels)

    def _at(self, some: Atlas, attribute: Array) -> Tensor:
        return torch.from_numpy(some.interpolate(attribute).T).to(self._dtype)

    def _roughness(self, some: Atlas) -> Tensor:
        return torch.full((some.count,), self.scene.roughness or 1.0, dtype=self._dtype)

    def _visibility(self, mesh: PosedMesh, some: Atlas, directions: Array) -> Tensor | None:
        if self.configuration.shadows == "none":
            return None
        trace: Any = visibility if self.configuration.shadows == "hard" else soft_visibility
        return torch.from_numpy(trace(mesh, some, directions, np.zeros((0, 3))))

    def _drawn(self, raster: Raster, texels: Tensor | None, diffuse: Tensor, specular: Tensor | None) -> Array:
        colour = self._albedo.to(self._dtype) * diffuse
        if specular is not None and self.scene.roughness is not None:
            colour = colour + specular
        colour = colour.float() if colour.dtype == torch.bfloat16 else colour
        if texels is not None:
            colour = colour.new_zeros(3, self.atlas.count).index_copy(1, texels, colour)
        picture = raster.sample(self.atlas.dilate(self.atlas.scatter(colour)))
        return picture.permute(1, 2, 0).numpy()


class KnownPose:
    """A pose whose transfer is kept."""

    def __init__(self, core: Core, raster: Raster, texels: Tensor | None, kept: Tensor) -> None:
        self._core, self._raster, self._texels, self._kept = core, raster, texels, kept

    @torch.no_grad()
    def picture(self, environment: Environment) -> Array:
        """The picture (H, W, 3) under a map of the scene's size."""
        rows, columns = _columns(self._core.configuration, environment)
        _, irradiance = to_directional(environment, rows, columns, dark=True)
        if len(self._kept) == 2:
            return self._core._drawn(self._raster, self._texels, *relight(self._kept, irradiance))
        power = torch.from_numpy(irradiance.T.copy()).to(self._kept.dtype)
        return self._core._drawn(self._raster, self._texels, power @ self._kept[0], None)


def lights_of(environment: Environment, configuration: Configuration) -> LightSet:
    """The map as a configuration's distant lights; a grid keeps its dark texels."""
    nothing = np.zeros((0, 3))
    if not isinstance(configuration.lights, int):
        return LightSet(*to_directional(environment, *configuration.lights, dark=True), nothing, nothing)
    split = max(1, min(_SPLIT, 256 // environment.radiance.shape[0]))
    finer = Environment(environment.name, environment.radiance.repeat(split, axis=0).repeat(split, axis=1))
    return LightSet(*reduced(finer, configuration.lights), nothing, nothing)


def _columns(configuration: Configuration, environment: Environment) -> tuple[int, int]:
    """Rows and columns of the kept transfer: the grid's, or the map's where the grid is finer."""
    if isinstance(configuration.lights, int):
        raise TypeError("a kept transfer needs a grid of directions")
    height, width = environment.radiance.shape[:2]
    return min(configuration.lights[0], height), min(configuration.lights[1], width)


def _owners(configuration: Configuration, environment: Environment) -> tuple[Array, Array]:
    """For each direction of the grid the column of the transfer it belongs to, and its share of that solid angle."""
    if isinstance(configuration.lights, int):
        raise TypeError("a kept transfer needs a grid of directions")
    (rows, columns), (height, width) = configuration.lights, _columns(configuration, environment)
    row, column = np.divmod(np.arange(rows * columns), columns)
    owner = row * height // rows * width + column * width // columns
    solid = solid_angles(rows, columns)[row, column]
    return owner, solid / np.bincount(owner, solid)[owner]


def _column(shares: Array, like: Tensor) -> Tensor:
    return torch.from_numpy(shares).to(like.dtype)[:, None]
