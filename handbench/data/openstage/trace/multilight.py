"""One wavefront of camera paths that gathers every light at once (Dr.Jit kernels, vectorised variants only).

Path tracing light by light repeats the same camera rays and the same bounces. Here each path vertex asks all
lights (next-event estimation) and adds to one image per light, so thirty lights cost little more than thirty
shadow rays. Environments are split in two: the few bright texels are sampled by power (`_bright`), the smooth
rest is read where BSDF-sampled rays leave the scene, one ray for all environments. Both parts are unbiased.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.stats import qmc

from ....scene import Array, Camera, Directional, Environment, Known, Point
from .envtables import EnvironmentTables, environment_tables

_DIMENSIONS = 6
"""Sample dimensions of a path vertex: 3 for the BSDF, 1 to choose a bright texel, 2 within it."""


class MultiLight:
    """Renders a Mitsuba scene of one shape (no emitters) under many lights in one pass."""

    def __init__(self) -> None:
        self._tables: dict[tuple[int, ...], tuple[tuple[Environment, ...], EnvironmentTables]] = {}

    def render(
        self,
        scene: Any,
        camera: Camera,
        window: tuple[int, int, int, int],
        lights: Sequence[Known],
        spp: int,
        seed: int,
        max_depth: int,
        grid: int,
    ) -> Array:
        """Radiance (len(lights), h, w, 3) float32 in the window (x0, y0, x1, y1), over black.

        max_depth counts path segments as Mitsuba does: 2 is direct light only. Camera samples lie on a regular
        grid x grid within the pixel (spp is rounded up to a multiple); each place asks the delta lights once at the
        first vertex, where more samples would repeat it, and all samples feed environments and bounces.
        """
        grid = min(grid, math.isqrt(spp))
        spp = -(-spp // grid**2) * grid**2
        deltas_of = {i: light for i, light in enumerate(lights) if not isinstance(light, Environment)}
        maps_of = {i: light for i, light in enumerate(lights) if isinstance(light, Environment)}
        delta, distant = list(deltas_of), list(maps_of)
        x0, y0, x1, y1 = window
        pixels = (x1 - x0) * (y1 - y0)
        samples = _sample_table(spp, grid, _DIMENSIONS * (max_depth - 1), seed)
        deltas = _delta_arrays(list(deltas_of.values()))
        tables = self._environments(tuple(maps_of.values()))
        image = dr.zeros(mi.Float, (len(delta) + len(distant)) * pixels * 3)

        ray, pixel, sample = _camera_rays(scene, camera, window, samples, spp)
        beta = dr.full(mi.Color3f, 1.0, dr.width(pixel))
        for depth in range(1, max_depth):
            if dr.width(pixel) == 0:
                break
            asking = grid**2 if depth == 1 else spp
            ray, beta, alive = _vertex(
                scene, ray, beta, pixel, sample, samples, deltas, tables, image,
                counts=(len(delta), len(distant), pixels), asking=asking, spp=spp, depth=depth, seed=seed,
                last=depth == max_depth - 1,
            )  # fmt: skip
            keep: Any = dr.compress(alive)
            ray = mi.Ray3f(dr.gather(mi.Point3f, ray.o, keep), dr.gather(mi.Vector3f, ray.d, keep))
            beta = dr.gather(mi.Color3f, beta, keep)
            pixel, sample = dr.gather(mi.UInt32, pixel, keep), dr.gather(mi.UInt32, sample, keep)
            dr.eval(ray, beta, pixel, sample)

        found = image.numpy().reshape(len(lights), y1 - y0, x1 - x0, 3) / np.float32(spp)
        result = np.empty_like(found)
        result[delta + distant] = found
        return result

    def _environments(self, environments: tuple[Environment, ...]) -> EnvironmentTables:
        """Sampling tables, kept for the last set of environments (views share it)."""
        key = tuple(map(id, environments))
        if key not in self._tables:
            self._tables = {key: (environments, environment_tables(environments))}
        return self._tables[key][1]


def _sample_table(spp: int, grid: int, dimensions: int, seed: int) -> Any:
    """Flattened (spp, 2 + dimensions): the place in the pixel, on the grid in turn, then scrambled Sobol points."""
    turn = np.arange(spp) % grid**2
    place = (np.stack([turn % grid, turn // grid], axis=1) + 0.5) / grid
    points = qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(seed)).random_base2((spp - 1).bit_length())
    return mi.Float(np.concatenate([place, points[:spp]], axis=1).astype(np.float32).ravel())


def camera_ray(camera: Camera, x: Any, y: Any) -> Any:
    """Rays through raster positions (x, y), in pixels; OpenCV pinhole."""
    matrix = mi.Matrix3f(camera.ray_matrix.T.tolist())
    matrix, origin = dr.opaque(mi.Matrix3f, 0.0) + matrix, mi.Point3f(dr.opaque(mi.Float, 0.0))
    origin += mi.Point3f(*(dr.opaque(mi.Float, float(c)) for c in camera.centre))
    return mi.Ray3f(origin, dr.normalize(matrix @ mi.Vector3f(x, y, 1.0)))


def _camera_rays(
    scene: Any, camera: Camera, window: tuple[int, int, int, int], samples: Any, spp: int
) -> tuple[Any, Any, Any]:
    """Rays that hit, with the pixel (in the window) and the sample each belongs to; sample-major order."""
    x0, y0, x1, y1 = window
    width, pixels = x1 - x0, (x1 - x0) * (y1 - y0)
    stride = dr.width(samples) // spp
    index = dr.arange(mi.UInt32, pixels * spp)
    count = dr.opaque(mi.UInt32, pixels)
    sample, pixel = index // count, index % count
    columns = dr.opaque(mi.UInt32, width)
    x = mi.Float(pixel % columns) + dr.opaque(mi.Float, x0) + dr.gather(mi.Float, samples, sample * stride)
    y = mi.Float(pixel // columns) + dr.opaque(mi.Float, y0) + dr.gather(mi.Float, samples, sample * stride + 1)
    ray = camera_ray(camera, x, y)
    hit = scene.ray_test(ray)
    dr.eval(ray, hit, pixel, sample)
    keep: Any = dr.compress(hit)
    found = mi.Ray3f(dr.gather(mi.Point3f, ray.o, keep), dr.gather(mi.Vector3f, ray.d, keep))
    pixel, sample = dr.gather(mi.UInt32, pixel, keep), dr.gather(mi.UInt32, sample, keep)
    dr.eval(found, pixel, sample)
    return found, pixel, sample


def _delta_arrays(lights: Sequence[Directional | Point]) -> tuple[Any, Any]:
    """(position or direction xyz, 1 if a point) and colour, flattened 4 and 3 a light."""
    places = [[*light.direction, 0.0] if isinstance(light, Directional) else [*light.position, 1.0] for light in lights]
    colours = [light.irradiance if isinstance(light, Directional) else light.intensity for light in lights]
    return mi.Float(np.ravel(places).astype(np.float32)), mi.Float(np.ravel(colours).astype(np.float32))


def _vertex(
    scene: Any,
    ray: Any,
    beta: Any,
    pixel: Any,
    sample: Any,
    samples: Any,
    deltas: tuple[Any, Any],
    tables: EnvironmentTables,
    image: Any,
    counts: tuple[int, int, int],
    asking: int,
    spp: int,
    depth: int,
    seed: int,
    last: bool,
) -> tuple[Any, Any, Any]:
    """Gather all lights at the vertices the rays hit; returns the next rays, throughputs and which go on."""
    n_delta, n_distant, pixels = counts
    stride = dr.width(samples) // spp
    base = sample * stride + dr.opaque(mi.UInt32, 2 + _DIMENSIONS * (depth - 1))
    turn: Any = dr.opaque(mi.UInt32, (seed * 64 + depth) * _DIMENSIONS)

    def draw(k: int) -> Any:
        """Sobol sample of dimension k, rotated per pixel (Cranley-Patterson)."""
        value = dr.gather(mi.Float, samples, base + k) + mi.sample_tea_float32(pixel, turn + k)
        return value - dr.floor(value)

    si = scene.ray_intersect(ray)
    bsdf = si.bsdf()
    context = mi.BSDFContext()
    asks = sample < dr.opaque(mi.UInt32, asking)
    weight = beta * dr.opaque(mi.Float, spp / asking)
    if n_delta:
        _ask_deltas(scene, si, bsdf, context, asks, weight, pixel, deltas, image, n_delta, pixels)
    if n_distant:
        _ask_bright(
            scene, si, bsdf, context, si.is_valid(), beta, pixel, (draw(3), draw(4), draw(5)), tables, image, n_delta,
            n_distant, pixels,
        )  # fmt: skip
    picked, factor = bsdf.sample(context, si, draw(0), mi.Point2f(draw(1), draw(2)))
    onward = si.spawn_ray(si.to_world(picked.wo))
    beta = beta * factor
    alive = si.is_valid() & (dr.max(beta) > 0)
    hit = scene.ray_test(onward, alive)
    if n_distant:
        _add_rest(onward.d, beta, alive & ~hit, pixel, tables, image, n_delta, n_distant, pixels)
    alive &= hit
    if last:
        alive &= False
    dr.eval(image, onward, beta, alive)
    return onward, beta, alive


@dr.syntax
def _ask_deltas(scene, si, bsdf, context, asks, weight, pixel, deltas, image, n_delta, pixels):  # type: ignore[no-untyped-def]  # fmt: skip
    """Next-event estimation of every directional and point light."""
    places, colours = deltas
    light = dr.select(asks, mi.UInt32(0), dr.opaque(mi.UInt32, n_delta))
    count, area = dr.opaque(mi.UInt32, n_delta), dr.opaque(mi.UInt32, pixels)
    while dr.hint(light < count, exclude=[scene, si, bsdf, context, image]):
        place = dr.gather(mi.Vector4f, places, light)
        near = place.w > 0.5
        towards = mi.Vector3f(place.x, place.y, place.z) - dr.select(near, mi.Vector3f(si.p), 0.0)
        squared = dr.squared_norm(towards)
        towards *= dr.rsqrt(squared)
        wo = si.to_local(towards)
        facing = (wo.z > 0) & (dr.dot(si.n, towards) > 0)
        shadow = si.spawn_ray(towards)
        shadow.maxt = dr.select(near, dr.sqrt(squared) * (1 - 1e-4), dr.largest(mi.Float))
        facing &= ~scene.ray_test(shadow, facing)
        value = weight * bsdf.eval(context, si, wo, facing) * dr.gather(mi.Color3f, colours, light, facing)
        value /= dr.select(near, squared, 1.0)
        dr.scatter_add(image, value, light * area + pixel, facing)
        light += 1


@dr.syntax
def _ask_bright(scene, si, bsdf, context, asks, weight, pixel, draws, tables, image, n_delta, n_distant, pixels):  # type: ignore[no-untyped-def]  # fmt: skip
    """Next-event estimation of the bright texels of every environment, one sample each, chosen by power."""
    pick, jitter_x, jitter_y = draws
    normal = mi.Vector3f(si.sh_frame.n)
    light = dr.select(asks, mi.UInt32(0), dr.opaque(mi.UInt32, n_distant))
    first, count, area = dr.opaque(mi.UInt32, n_delta), dr.opaque(mi.UInt32, n_distant), dr.opaque(mi.UInt32, pixels)
    while dr.hint(light < count, exclude=[scene, si, bsdf, context, tables, image]):
        towards, radiance, there = tables.sample_bright(light, normal, pick, jitter_x, jitter_y)
        wo = si.to_local(towards)
        facing = there & (wo.z > 0) & (dr.dot(si.n, towards) > 0)
        facing &= ~scene.ray_test(si.spawn_ray(towards), facing)
        value = weight * bsdf.eval(context, si, wo, facing) * radiance
        dr.scatter_add(image, value, (first + light) * area + pixel, facing)
        light += 1


@dr.syntax
def _add_rest(direction, beta, escaped, pixel, tables, image, n_delta, n_distant, pixels):  # type: ignore[no-untyped-def]  # fmt: skip
    """Add the smooth rest of every environment along rays that left the scene."""
    light = dr.select(escaped, mi.UInt32(0), dr.opaque(mi.UInt32, n_distant))
    first, count, area = dr.opaque(mi.UInt32, n_delta), dr.opaque(mi.UInt32, n_distant), dr.opaque(mi.UInt32, pixels)
    while dr.hint(light < count, exclude=[tables, image]):
        value = beta * tables.rest(light, direction)
        dr.scatter_add(image, value, (first + light) * area + pixel, escaped)
        light += 1
