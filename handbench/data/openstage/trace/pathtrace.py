"""The path-traced reference: a textured surface under many lights, with interreflection (Mitsuba 3).

`llvm_ad_rgb` renders all lights in one wavefront (`multilight`); `scalar_rgb`, for machines without LLVM, runs
Mitsuba's own `path` integrator light by light.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import mitsuba as mi
import numpy as np
from scipy.ndimage import map_coordinates

from ....errors import InputError
from ....render.see.raster import Raster, rasterise
from ....render.uv.surface import mesh_normals
from ....scene import Array, Camera, Known, Light, Mesh, known_leaves, leaves
from .llvm import SCALAR, VECTORISED, choose_variant
from .mitsuba_scene import TracedSurface, emitter, sensor, shape

__all__ = ["GBuffer", "PathTracer", "TracedSurface", "choose_variant", "displace"]

GRID = 4
"""Places in a pixel: a regular GRID x GRID, so that coverage is the same in images and geometry."""


class Displaced(Protocol):
    """Anything with a displacement map (R, R), metres along the normal, row 0 = top."""

    @property
    def displacement(self) -> Array: ...


@dataclass(frozen=True, eq=False)
class GBuffer:
    """Per pixel: alpha (H, W), normal (H, W, 3) world, depth (H, W) metres along z, uv (H, W, 2); zero outside."""

    alpha: Array
    normal: Array
    depth: Array
    uv: Array


_PATHS = 8_000_000
"""Camera paths traced at once: with all their state about 2 GB."""


class PathTracer:
    """Renders surfaces; keeps the scene of the last surface, so cameras of one pose share it."""

    def __init__(self, variant: str) -> None:
        if variant not in (VECTORISED, SCALAR):
            raise InputError(f"path tracer: unknown variant {variant!r}; use {VECTORISED!r} or {SCALAR!r}")
        mi.set_variant(variant)
        self._variant = variant
        self._surface: TracedSurface | None = None
        self._shape: Any = None
        self._scene: Any = None
        if variant == VECTORISED:
            from .multilight import MultiLight

            self._multilight = MultiLight()

    def render(
        self,
        surface: TracedSurface,
        camera: Camera,
        lights: Sequence[Light],
        spp: int,
        seed: int,
        max_depth: int = 4,
    ) -> Array:
        """Images (len(lights), H, W, 3) float32, linear, premultiplied over black.

        spp is rounded up to a multiple of GRID², the places in a pixel; each place asks delta lights once, all samples
        feed environments and interreflection. max_depth counts segments as Mitsuba does: 2 is direct light, 4 adds
        two interreflections. A group is the sum of its members' images.
        Raises `Unsupported` for an unknown light.
        """
        singles = [leaf for light in lights for leaf in known_leaves(light)]
        box = camera.box(surface.mesh.vertices)
        images = np.zeros((len(lights), camera.height, camera.width, 3), np.float32)
        if not singles or not box.pixels:
            return images
        mi.set_variant(self._variant)
        self._load(surface)
        x0, y0, x1, y1 = box
        if self._variant == VECTORISED:
            rows = max(1, _PATHS // (spp * (x1 - x0)))
            bands = [(x0, top, x1, min(top + rows, y1)) for top in range(y0, y1, rows)]
            strips = [
                self._multilight.render(self._scene, camera, band, singles, spp, seed + i, max_depth, GRID)
                for i, band in enumerate(bands)
            ]
            found = np.concatenate(strips, axis=1)
        else:
            found = np.stack([self._render_one(camera, one, spp, seed, max_depth) for one in singles])
            found = found[:, y0:y1, x0:x1]
        parts = iter(found)
        for image, light in zip(images, lights, strict=True):
            for _ in leaves(light):
                image[y0:y1, x0:x1] += next(parts)
        return images

    def gbuffer(self, surface: TracedSurface, camera: Camera, spp: int) -> GBuffer:
        """Coverage and geometry averaged over the covered of sqrt(spp)² samples; uv from the one nearest the centre."""
        raster = rasterise(surface.mesh, camera, max(1, math.isqrt(spp)))
        return GBuffer(raster.alpha, raster.normal_map, raster.depth_map, _central_uv(raster))

    def _load(self, surface: TracedSurface) -> None:
        if surface is not self._surface:
            self._shape = shape(surface)
            self._scene = mi.load_dict({"type": "scene", "shape": self._shape})
            self._surface = surface

    def _render_one(self, camera: Camera, light: Known, spp: int, seed: int, max_depth: int) -> Array:
        """One light with Mitsuba's `path` integrator."""
        scene = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": max_depth, "rr_depth": 1000, "hide_emitters": True},
                "sensor": sensor(camera),
                "emitter": emitter(light),
                "shape": self._shape,
            }
        )
        return np.asarray(mi.render(scene, spp=spp, seed=mi.UInt32(seed)), dtype=np.float32)[..., :3]


def displace(mesh: Mesh, skin: Displaced) -> Mesh:
    """The mesh with its vertices moved along their smooth normals by the displacement read at their UVs (bilinear).

    A vertex with several UVs, on a seam, moves by the mean over its faces, so the surface stays closed.
    """
    size = skin.displacement.shape[0]
    uvs, uv_faces = mesh.topology.unwrapped
    at = np.stack([(1 - uvs[:, 1]) * size - 0.5, uvs[:, 0] * size - 0.5])
    read = map_coordinates(np.asarray(skin.displacement, np.float64), at, order=1, mode="nearest")
    corner = mesh.topology.faces.ravel()
    count = np.bincount(corner, minlength=len(mesh.vertices))
    total = np.bincount(corner, read[uv_faces.ravel()], minlength=len(mesh.vertices))
    return Mesh(mesh.vertices + mesh_normals(mesh) * (total / np.maximum(count, 1))[:, None], mesh.topology)


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
