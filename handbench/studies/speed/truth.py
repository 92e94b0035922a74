"""The picture that errors are measured against: brute force in float64, written without the lighting core.

A pixel is the mean of GRID x GRID points on a regular grid. Each point looks in stratified random directions into
every texel of the environment, more of them into texels of more power, and traces a shadow ray along each one
above its horizon; what reaches it is reflected as the equations of `render.reference` are printed. Rays start on
the triangle itself, and cosines are those of the smooth normals, as renderers have it. Points of a pixel use
independent directions, so what error is left is noise, which the two halves of the points measure.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.ndimage import binary_erosion

from ...cache import cache_folder
from ...errors import StorageError
from ...files import whole
from ...method import Progress, silent
from ...render.see.raster import rasterise
from ...render.see.rays import RayScene
from ...render.uv.surface import face_normals
from ...scene import Array, Environment
from .scene import Scene

GRID = 4
"""Points along a pixel's side."""

DIRECTIONS = 1024
"""Directions a point asks for, about; never fewer than one a texel."""

_SETS = 256
"""Sets of directions; points of one set share them."""

_VERSION = 1
"""Raise when the reference itself changes: pictures kept on disk are then made anew."""


@dataclass(frozen=True)
class Truth:
    """The converged picture at `pixels` (P,), flat indices of pixels well inside the hand: values (P, 3).

    noise: the relative RMSE that is left, from the two halves of the points.
    """

    pixels: Array
    values: Array
    noise: float

    def error(self, image: Array) -> float:
        """Relative RMSE of a picture (H, W, 3): sqrt(sum (a - b)^2 / sum b^2) over pixels well inside.

        Those are the pixels that the hand covers whole, as it does their eight neighbours. At the outline the pixel
        filter would be compared, and what each renderer does with normals that look away, not the light.
        """
        found = np.asarray(image, dtype=np.float64).reshape(-1, 3)[self.pixels]
        return relative_rmse(found, self.values)


def relative_rmse(found: Array, expected: Array) -> float:
    """sqrt(sum (found - expected)^2 / sum expected^2)."""
    return float(np.sqrt(np.square(found - expected).sum() / np.square(expected).sum()))


def truth(scene: Scene, directions: int = DIRECTIONS, grid: int = GRID, progress: Progress = silent) -> Truth:
    """The reference of a scene, from disk if it was made before. Takes about a minute otherwise."""
    key = hashlib.sha256(f"{_VERSION} {scene.digest} {directions} {grid}".encode()).hexdigest()[:24]
    path = cache_folder() / "speed" / f"{key}.npz"
    try:
        with np.load(path) as kept:
            return Truth(kept["pixels"], kept["values"], float(kept["noise"]))
    except (OSError, ValueError, KeyError, EOFError):
        pass
    found = compute(scene, directions, grid, progress)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole(path) as part, part.open("wb") as file:
            np.savez(file, pixels=found.pixels, values=found.values, noise=found.noise)
    except (StorageError, OSError):
        pass  # a cache that cannot be written only means computing again
    return found


def compute(scene: Scene, directions: int, grid: int, progress: Progress = silent, seed: int = 0) -> Truth:
    """The reference, computed."""
    mesh, camera = scene.mesh, scene.camera
    raster = rasterise(mesh, camera, grid)
    full = np.bincount(raster.pixel, minlength=camera.height * camera.width) == grid * grid
    full = binary_erosion(full.reshape(camera.height, camera.width), np.ones((3, 3)), border_value=1).ravel()
    chosen = np.flatnonzero(full[raster.pixel])
    pixel = raster.pixel[chosen]
    rng = np.random.default_rng(seed)
    # the k-th point of a pixel uses one of the sets k, k + grid^2, ... so points of one pixel never share a set
    order = np.argsort(pixel, kind="stable")
    turn = np.empty(len(pixel), dtype=np.int64)
    turn[order] = np.tile(np.arange(grid * grid), len(pixel) // (grid * grid))
    member = turn + grid * grid * rng.integers(0, max(1, _SETS // (grid * grid)), len(pixel))
    corners = mesh.vertices[mesh.topology.faces[raster.face[chosen]]]
    rays = RayScene(mesh.vertices, mesh.topology.faces)
    lift = rays.epsilon * face_normals(mesh.vertices, mesh.topology.faces)[raster.face[chosen]]
    position = np.einsum("sk,skc->sc", raster.barycentric[chosen].astype(np.float64), corners)
    normal = raster.normal[chosen]
    view = camera.centre - position
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    share = texel_shares(scene.environment, directions)
    values = np.zeros((len(pixel), 3))
    groups = [g for g in np.split(np.argsort(member, kind="stable"), np.cumsum(np.bincount(member))[:-1]) if len(g)]
    for done, group in enumerate(groups, start=1):
        towards, power = stratified(scene.environment, share, rng)
        seen = _unblocked(rays, position[group] + lift[group], normal[group], towards)
        values[group] = _reflected(scene, normal[group], view[group], towards, power, seen)
        progress(done, len(groups))
    pixels = np.flatnonzero(full)
    index = (np.cumsum(full) - 1)[pixel]
    checker = (turn // grid + turn % grid) % 2  # both colours have their mean place in the pixel's middle
    first, second = (_mean(values, index, checker == side, len(pixels)) for side in (0, 1))
    picture = (first + second) / 2
    return Truth(pixels, picture, relative_rmse(first, second) / 2)


def _mean(values: Array, index: Array, chosen: Array, count: int) -> Array:
    sums = [np.bincount(index[chosen], values[chosen, c], minlength=count) for c in range(3)]
    return np.stack(sums, axis=1) / np.bincount(index[chosen], minlength=count)[:, None]


def texel_shares(environment: Environment, directions: int) -> Array:
    """Strata along a side (H, W) of each texel: their squares are in proportion to power, at least one."""
    height, _width = environment.radiance.shape[:2]
    bands = -np.diff(np.cos(np.linspace(0.0, np.pi, height + 1)))
    power = environment.radiance.astype(np.float64).sum(axis=2) * bands[:, None]
    wanted = directions * power / max(power.sum(), 1e-300)
    return np.where(power > 0, np.maximum(1, np.rint(np.sqrt(wanted))), 0).astype(int)


def stratified(environment: Environment, share: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Random unit directions (M, 3), one in each of the share x share strata of a texel, and irradiance (M, 3)."""
    height, width = environment.radiance.shape[:2]
    row, column = np.nonzero(share)
    k = share[row, column]
    texel = np.repeat(np.arange(len(k)), k * k)
    within = np.arange(len(texel)) - np.repeat(np.cumsum(k * k) - k * k, k * k)
    row, column, side = row[texel], column[texel], k[texel]
    u, v = rng.random((2, len(texel)))
    phi = 2.0 * np.pi * (column + (within % side + u) / side) / width
    top, bottom = np.cos(np.pi * row / height), np.cos(np.pi * (row + 1) / height)
    up = top + (bottom - top) * (within // side + v) / side
    ring = np.sqrt(np.maximum(0.0, 1.0 - up * up))
    towards = np.stack([ring * np.sin(phi), up, -ring * np.cos(phi)], axis=1)
    solid = (top - bottom) * 2.0 * np.pi / width / side**2
    return towards, environment.radiance[row, column].astype(np.float64) * solid[:, None]


def _unblocked(rays: RayScene, origins: Array, normals: Array, towards: Array) -> Array:
    """Which pairs (M, n) are above the smooth horizon and free."""
    light, point = np.nonzero(towards @ normals.T > 0)
    packed = np.empty((len(light), 6), dtype=np.float32)
    packed[:, :3], packed[:, 3:] = origins[point] - rays.centre, towards[light]
    seen = np.zeros((len(towards), len(origins)), dtype=bool)
    seen[light, point] = ~rays.blocked(packed)
    return seen


def _reflected(scene: Scene, normal: Array, view: Array, towards: Array, power: Array, seen: Array) -> Array:
    """Radiance (n, 3) of albedo / pi C^d and, for the BRDF, + C^s, over M directions."""
    diffuse = np.maximum(normal @ towards.T, 0.0) * seen.T @ power
    radiance: Array = scene.albedo / np.pi * diffuse
    if scene.roughness is None:
        return radiance
    return radiance + _specular(normal, view, scene.roughness, towards, power, seen)


def _specular(normal: Array, view: Array, roughness: float, towards: Array, power: Array, seen: Array) -> Array:
    """The specular feature (n, 3), points padded to few sizes, as every new one is compiled."""
    import jax

    pad = -len(normal) % 256
    points = [np.concatenate([values, np.tile(values[:1], (pad, 1))]) for values in (normal, view)]
    lit = np.concatenate([seen, np.zeros((len(seen), pad), dtype=bool)], axis=1)
    with jax.enable_x64(True):
        found = _kernel()(*points, np.float64(roughness), towards, power, lit)
        return np.asarray(found)[: len(normal)]


@cache
def _kernel() -> Callable[..., Any]:
    import jax
    import jax.numpy as jnp

    from ...render.shade.reference import distribution, fresnel, geometry

    def features(normal, view, roughness, directions, irradiance, seen):  # type: ignore[no-untyped-def]
        n_view = (normal * view).sum(axis=1)

        def add(total, light):  # type: ignore[no-untyped-def]
            towards, power, lit = light
            cosine = normal @ towards
            half = towards + view
            half = half / jnp.maximum(jnp.linalg.norm(half, axis=1, keepdims=True), 1e-12)
            lobe = distribution((half * normal).sum(axis=1), roughness) * fresnel((half * view).sum(axis=1))
            lobe = lobe * geometry(n_view, cosine, roughness)
            above = lit & (cosine > 0) & (n_view > 0)
            return total + jnp.where(above, lobe * cosine, 0.0)[:, None] * power, None

        return jax.lax.scan(add, jnp.zeros_like(normal), (directions, irradiance, seen))[0]

    return jax.jit(features)
