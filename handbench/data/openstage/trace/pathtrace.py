"""The truth: a textured surface under many lights, with light that wanders under it and between its parts.

Light is worked out at the vertices once for all cameras (`bake`); a picture interpolates it and adds what the surface
mirrors (`view`). Rays are Embree's, sums have a fixed order: the same call gives the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ....errors import InputError
from ....render.see.posedmesh import PosedMesh
from ....render.see.raster import Raster, rasterise
from ....scene import Array, Camera, Environment, Known, Light, Mesh, known_leaves, leaves
from .bake import BakedSurface, Lit, lit
from .skies import Sky, sky
from .surface import TracedSurface, displace
from .view import Covered, picture

__all__ = ["GBuffer", "PathTracer", "TracedSurface", "displace"]

GRID = 4
"""Places in a pixel: a regular GRID x GRID, so that coverage is the same in images and geometry."""

_SAMPLES = 400_000
"""Places of a picture shaded at once: with all their state about 1 GB."""

_PER_RAY = 48


@dataclass(frozen=True, eq=False)
class GBuffer:
    """What a raster says per pixel: alpha (H, W), normal (H, W, 3) world, depth (H, W) metres along z, uv (H, W, 2);
    zero outside."""

    raster: Raster

    @property
    def alpha(self) -> Array:
        return self.raster.alpha

    @property
    def normal(self) -> Array:
        return self.raster.normal_map

    @property
    def depth(self) -> Array:
        return self.raster.depth_map

    @cached_property
    def uv(self) -> Array:
        """That of each pixel's covered sample nearest its centre."""
        return _central_uv(self.raster)


class PathTracer:
    """Renders surfaces; keeps the light on the last surface, so cameras of one pose share it, and what the last
    camera saw, so its picture and geometry do."""

    def __init__(self) -> None:
        self._posed: BakedSurface | None = None
        self._lit: Lit | None = None
        self._key: tuple[object, ...] = ()
        self._raster: Raster | None = None
        self._skies: dict[tuple[int, float], tuple[Environment, Sky]] = {}

    def render(
        self,
        surface: TracedSurface,
        camera: Camera,
        lights: Sequence[Light],
        spp: int,
        seed: int,
        max_depth: int = 4,
    ) -> Array:
        """Images (len(lights), H, W, 3) float32, linear, premultiplied over black; exactly additive over lights.

        spp is spent on what the surface mirrors: a ray and a sample of each environment in every of the GRID² places
        of a pixel for each 48 samples; diffuse light has no noise from it. max_depth counts segments of
        paths: 2 is direct light, 4 adds two interreflections. A group is the sum of its members' images.
        Raises `Unsupported` for an unknown light, `InputError` for spp or max_depth that are too small.
        """
        if spp < 1 or max_depth < 2:
            raise InputError(f"path tracer: spp {spp} must be at least 1 and max_depth {max_depth} at least 2")
        singles = tuple(leaf for light in lights for leaf in known_leaves(light))
        images = np.zeros((len(lights), camera.height * camera.width, 3), np.float32)
        if singles and camera.box(surface.mesh.vertices).pixels:
            posed = self._pose(surface)
            skies = [
                self._sky(light, surface.specular) if isinstance(light, Environment) else None for light in singles
            ]
            found = self._light(posed, singles, skies, max_depth - 2, seed)
            raster = self._seen(posed.mesh, camera, GRID)
            for samples in _bands(raster):
                view = Covered(posed, raster, samples)
                parts = iter(picture(view, found, skies, max(1, round(spp / _PER_RAY)), seed).astype(np.float32))
                for image, light in zip(images, lights, strict=True):
                    for _ in leaves(light):
                        image[view.pixels] += next(parts)
        return images.reshape(len(lights), camera.height, camera.width, 3)

    def gbuffer(self, surface: TracedSurface, camera: Camera, spp: int) -> GBuffer:
        """Coverage and geometry averaged over the covered of sqrt(spp)² samples."""
        mesh = self._posed.mesh if self._posed and self._posed.surface is surface else surface.mesh
        return GBuffer(self._seen(mesh, camera, max(1, math.isqrt(spp))))

    def _seen(self, mesh: Mesh | PosedMesh, camera: Camera, side: int) -> Raster:
        """What a camera sees of a mesh in side x side places of each pixel."""
        last = self._raster
        if last is None or last.mesh is not mesh or last.camera is not camera or last.supersample != side:
            self._raster = last = rasterise(mesh, camera, side)
        return last

    def _pose(self, surface: TracedSurface) -> BakedSurface:
        if self._posed is None or self._posed.surface is not surface:
            self._posed, self._lit = BakedSurface(surface), None
        return self._posed

    def _light(
        self, posed: BakedSurface, lights: tuple[Known, ...], skies: Sequence[Sky | None], bounces: int, seed: int
    ) -> Lit:
        key = (*map(id, lights), bounces, seed)
        if self._lit is None or self._key != key:
            self._lit, self._key = lit(posed, lights, skies, bounces, seed), key
        return self._lit

    def _sky(self, environment: Environment, specular: float) -> Sky:
        """Tables of a map, kept for all surfaces that this tracer draws."""
        key = (id(environment), specular)
        if key not in self._skies:
            self._skies[key] = environment, sky(environment, specular)
        return self._skies[key][1]


def _bands(raster: Raster) -> list[Array]:
    """The samples in parts of whole pixels, each sorted by pixel."""
    order = np.argsort(raster.pixel, kind="stable")
    ends = np.flatnonzero(np.diff(raster.pixel[order], append=-1)) + 1
    cuts = ends[np.searchsorted(ends, np.arange(_SAMPLES, len(order), _SAMPLES))]
    return [part for part in np.split(order, np.unique(cuts)) if len(part)]


def _central_uv(raster: Raster) -> Array:
    """UV (H, W, 2) of each pixel's covered sample nearest its centre."""
    camera, mesh = raster.camera, raster.mesh
    points = np.einsum("sk,skc->sc", raster.barycentric, mesh.vertices[mesh.topology.faces[raster.face]])
    places, _ = camera.project(points)
    centre = np.stack([raster.pixel % camera.width, raster.pixel // camera.width], axis=1) + 0.5
    nearest_last = np.argsort(-np.linalg.norm(places - centre, axis=1), kind="stable")
    uv = np.zeros((camera.height * camera.width, 2), np.float32)
    uv[raster.pixel[nearest_last]] = raster.uv[nearest_last]  # of repeated pixels the last is kept
    return uv.reshape(camera.height, camera.width, 2)
