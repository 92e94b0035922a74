"""Light on a posed surface, worked out once for all cameras: what arrives at its vertices and what leaves them.

Single lights cast one shadow ray from each vertex. Environments are shadowed by their unshadowed irradiance, exact for
the normal of each vertex, times the visible share of it, found by rays from fewer points: without noise where nothing
is hidden. Light between parts of the surface is one sparse matrix from the same rays, for all lights.
Every light is worked out on its own, so that sums over lights are exact.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ....light.environment import texels
from ....render.see.posedmesh import PosedMesh
from ....render.see.rays import Hits
from ....scene import Array, Directional, Environment, Known, Point
from .diffusion import Diffusion, diffusion
from .gloss import Reflected, dot, reflected
from .levels import Level, level, vertex_points
from .skies import REFERENCE_ROUGHNESS, Sky
from .surface import TracedSurface, at_vertices

_AROUND = 64
"""Rays from a point over its hemisphere, by cosine."""

_AIMED = 24
"""Shadow rays from a point to bright texels of each environment."""

_SPARSER = 2.0
_PLASTIC = (0.7548776662466927, 0.5698402909980532)
_GOLDEN3 = (0.8191725133961645, 0.6710436067037893, 0.5497004779019702)


class BakedSurface:
    """A surface that is ready to be lit: rays, textures at its vertices, diffusion and the ways of light between parts.

    free_path (V, 3) metres, albedo (V, 3), roughness (V,) at the vertices; `sparse` the points of slow changes.
    """

    def __init__(self, surface: TracedSurface) -> None:
        mesh = surface.mesh
        self.surface = surface
        self.mesh = PosedMesh(mesh)
        self.faces: Array = mesh.topology.faces
        self.albedo: Array = at_vertices(mesh, surface.albedo)
        self.roughness: Array = at_vertices(mesh, surface.roughness)
        self.free_path: Array = _free_path(surface)
        self.tables: Reflected = reflected(surface.specular)
        points = vertex_points(mesh.vertices, self.mesh.normals, self.faces)
        self.sparse: Level = level(points, _SPARSER * points.spacing)
        self.diffusion: Diffusion = diffusion(points, self.free_path, self.albedo, self.mesh.rays)
        self.mirrored: Array = self.tables.mean(self.roughness)
        """Share (V,) of even light that the lobes reflect."""

    @property
    def radiosity(self) -> Array:
        """What leaves each vertex (V, 3), by lobes and from inside, for light 1 that enters."""
        return self.albedo + (self.mirrored / (1 - self.mirrored))[:, None]


@dataclass(frozen=True, eq=False)
class Lit:
    """Light on a posed surface.

    seen: for every single light how much of it each vertex sees (V,) uint8; None for environments.
    leaves: three channels of (V, L) float32, light that has wandered and leaves, before the pigment.
    turns (V, 3 channels, 3 axes, E): how the light of each of the `environments` that enters grows as the normal turns.
    bounces: how often light went from one part of the surface to another.
    """

    lights: tuple[Known, ...]
    seen: tuple[Array | None, ...]
    leaves: tuple[Array, Array, Array]
    turns: Array
    environments: tuple[int, ...]
    bounces: int


def lit(posed: BakedSurface, lights: Sequence[Known], skies: Sequence[Sky | None], bounces: int, seed: int) -> Lit:
    """All lights on a surface; skies are the tables of those that are environments. bounces between parts: 0, 1, 2 …"""
    count = len(posed.mesh.vertices)
    shapes = {sky.density.shape for sky in skies if sky is not None}
    around = _around(posed, shapes, seed) if bounces or any(skies) else None
    arrives = np.zeros((3, count, len(lights)), np.float32)
    environments = tuple(i for i, sky in enumerate(skies) if sky is not None)
    turns = np.zeros((count, 3, 3, len(environments)), np.float32)
    seen: list[Array | None] = [None] * len(lights)
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        single = [i for i, sky in enumerate(skies) if sky is None]
        for i, (visible, entering) in zip(
            single, threads.map(lambda i: _single(posed, lights[i]), single), strict=True
        ):
            seen[i] = visible
            arrives[:, :, i] = entering * colour(lights[i])[:, None]
        if around is not None:
            mapped = threads.map(lambda i: _environment(posed, skies[i], around, seed), environments)  # type: ignore[arg-type]
            for k, (i, found) in enumerate(zip(environments, mapped, strict=True)):
                arrives[:, :, i], turns[..., k] = found
    if around is not None:
        between = _between(posed, around)
        for channel in range(3):
            arrives[channel] += _bounced(posed, between, channel, arrives[channel], bounces)
    leaves = tuple(posed.diffusion.apply(channel, arrives[channel]) for channel in range(3))
    return Lit(tuple(lights), tuple(seen), leaves, turns, environments, bounces)  # type: ignore[arg-type]


def colour(light: Known) -> Array:
    """RGB (3,) of a single light: irradiance, or radiant intensity of a point."""
    assert not isinstance(light, Environment)
    return light.irradiance if isinstance(light, Directional) else light.intensity


def towards(light: Known, positions: Array) -> tuple[Array, Array | float]:
    """Unit directions to a single light, (N, 3) or (1, 3), and what falls on a surface that faces it, per colour."""
    if isinstance(light, Directional):
        return light.direction[None], 1.0
    assert isinstance(light, Point)
    way = light.position - positions
    squared = dot(way, way)
    return way / np.sqrt(squared)[:, None], 1.0 / squared


def _single(posed: BakedSurface, light: Known) -> tuple[Array, Array]:
    """What sees a directional or point light (V,) uint8, and its light that enters there (V,)."""
    positions, normals, rays = posed.mesh.vertices, posed.mesh.normals, posed.mesh.rays
    direction, falling = towards(light, positions)
    cosine = dot(normals, direction)
    facing = np.flatnonzero(cosine > 0)
    start = positions[facing] + normals[facing] * rays.epsilon
    if isinstance(light, Point):
        blocked = rays.occluded(start, light.position - start, 1 - 1e-4)
    else:
        blocked = rays.occluded(start, direction)
    visible = np.zeros(len(cosine), np.uint8)
    visible[facing] = ~blocked
    cosine = np.maximum(cosine, 0)
    return visible, visible * cosine * (1 - posed.tables.at(cosine, posed.roughness)) * falling


@dataclass(frozen=True, eq=False)
class _Around:
    """Rays by cosine from the sparse points: what they hit, and texels (M, K) of maps of given shapes they point to."""

    hits: Hits
    texels: dict[tuple[int, ...], tuple[Array, Array]]


def _around(posed: BakedSurface, shapes: set[tuple[int, ...]], seed: int) -> _Around:
    middle = posed.sparse.middle
    rng = np.random.default_rng([seed, 1])
    u, v = ((_spread(_AROUND, _PLASTIC)[:, k] + rng.random((len(middle), 1), np.float32)) % 1.0 for k in range(2))
    radius, turn = np.sqrt(u), 2 * np.pi * v
    local = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - u)], axis=2)
    directions = to_world(posed.mesh.normals[middle].astype(np.float32), local)
    hits = posed.mesh.rays.cast(_starts(posed, _AROUND), directions.reshape(-1, 3))
    return _Around(hits, {shape: texels(directions, *shape) for shape in shapes})


def _starts(posed: BakedSurface, times: int) -> Array:
    """Where rays from the sparse points start, each repeated."""
    middle = posed.sparse.middle
    start = posed.mesh.vertices[middle] + posed.mesh.normals[middle] * posed.mesh.rays.epsilon
    return start.repeat(times, axis=0)


def _environment(posed: BakedSurface, sky: Sky, around: _Around, seed: int) -> tuple[Array, Array]:
    """Light of a map that enters each vertex (3, V), and how it turns (V, 3, 3)."""
    enters, turns = sky.unshadowed(posed.mesh.normals)
    found = sky.rest[around.texels[sky.density.shape]]
    free = ~around.hits.hit.reshape(found.shape[:2])
    shares = np.stack([_share(found, free), _aimed(posed, sky, seed)], axis=1)  # (M, 2, 3)
    shares = (posed.sparse.spread @ shares.reshape(len(shares), -1)).reshape(-1, 2, 3)
    rougher = (1 - posed.mirrored) / (1 - posed.tables.mean(np.array(REFERENCE_ROUGHNESS)))
    shares *= rougher[:, None, None]
    return (enters * shares).sum(axis=1).T, (turns * shares[..., None]).sum(axis=1)


def _share(light: Array, free: Array) -> Array:
    """Which share of light (M, K, 3) comes along the free ones of K ways; 1 where there is none."""
    whole, left = np.einsum("mkc->mc", light), np.einsum("mkc,mk->mc", light, free.astype(light.dtype))
    return np.where(whole > 0, left / np.where(whole > 0, whole, 1), 1.0)


def _aimed(posed: BakedSurface, sky: Sky, seed: int) -> Array:
    """The visible share (M, 3) of a map's bright texels."""
    middle, rays = posed.sparse.middle, posed.mesh.rays
    if not len(sky.slots):
        return np.ones((len(middle), 3))
    rng = np.random.default_rng([seed, 2])
    picks = [(_spread(_AIMED, _GOLDEN3)[:, k] + rng.random((len(middle), 1), np.float32)) % 1.0 for k in range(3)]
    direction, radiance = sky.aim(*(pick.ravel() for pick in picks))
    normals = posed.mesh.normals[middle].repeat(_AIMED, axis=0)
    cosine = np.maximum(dot(direction, normals), 0)
    facing = np.flatnonzero(cosine)
    free = np.zeros(len(cosine), bool)
    free[facing] = ~rays.occluded(_starts(posed, _AIMED)[facing], direction[facing])
    light = radiance * cosine[:, None]
    return _share(light.reshape(len(middle), _AIMED, 3), free.reshape(len(middle), _AIMED))


def _between(posed: BakedSurface, around: _Around) -> csr_array:
    """From light that leaves all vertices to light that enters the sparse points (M, V)."""
    hits, middle = around.hits, posed.sparse.middle
    hit = np.flatnonzero(hits.hit)
    count = np.bincount(hit // _AROUND, minlength=len(middle))
    starts = np.concatenate([[0], np.cumsum(3 * count)]).astype(np.int32)
    enters = ((1 - posed.mirrored[middle]) / _AROUND).repeat(count)
    weights = hits.barycentric[hit] * enters[:, None]
    columns = posed.faces[hits.face[hit]]
    return csr_array(
        (weights.ravel().astype(np.float32), columns.ravel().astype(np.int32), starts),
        shape=(len(middle), len(posed.mesh.vertices)),
    )


def _bounced(posed: BakedSurface, between: csr_array, channel: int, arrives: Array, bounces: int) -> Array:
    """Light (V, L) that enters after it left other parts of the surface."""
    radiosity = posed.radiosity[:, channel, None].astype(np.float32)
    total, last = np.zeros_like(arrives), arrives
    for _ in range(bounces):
        last = posed.sparse.spread @ (between @ (radiosity * last))
        total += last
    return total


def _free_path(surface: TracedSurface) -> Array:
    """Mean free paths (V, 3) at the vertices."""
    mesh, path = surface.mesh, surface.mean_free_path
    if path is None:
        return np.zeros((len(mesh.vertices), 3))
    path = np.asarray(path)
    if path.ndim == 1:
        return np.broadcast_to(path.astype(np.float64), (len(mesh.vertices), 3))
    return at_vertices(mesh, path)


def _spread(count: int, steps: tuple[float, ...]) -> Array:
    """Evenly spread points (count, d) of the unit cube: an additive recurrence."""
    return (np.arange(count)[:, None] * np.array(steps) % 1.0).astype(np.float32)


def to_world(normals: Array, local: Array) -> Array:
    """Vectors (N, …, 3) in frames whose z are the normals (N, 3), in the world.

    Duff et al., "Building an orthonormal basis, revisited", 2017.
    """
    x, y, z = normals.T
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1 / (sign + z)
    b = x * y * a
    first = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=1)
    second = np.stack([b, sign + y * y * a, -y], axis=1)
    shape = (len(normals), *(1,) * (local.ndim - 2), 3)
    return (
        local[..., :1] * first.reshape(shape)
        + local[..., 1:2] * second.reshape(shape)
        + local[..., 2:] * normals.reshape(shape)
    )
