"""A camera's picture of a lit surface: light that left its vertices, and what its two lobes mirror.

Every light is summed in a fixed order by one thread, so pictures are equal to the bit from run to run.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.sparse import csr_array

from ....light.environment import texels
from ....render.see.raster import Raster
from ....render.uv.surface import unit_rows
from ....scene import Array
from .bake import BakedSurface, Lit, colour, to_world, towards
from .diffusion import escaped
from .gloss import WEIGHTS, alphas, density, dot, gloss, sample
from .skies import Sky
from .surface import read

_FURROW = 2.5e-4
"""Metres: how wide the relief is that only tilts normals; light that leaves within it shows it."""

_GRAZING = 0.03
"""The least cosine of a tilted normal to the view."""

_EDGE, _MORE = 0.35, 4
"""Where the cosine to the view is lower, surfaces mirror much: so many times more rays are spent there."""

_STEPS = (0.7548776662466927, 0.5698402909980532)
_GOLDEN3 = (0.8191725133961645, 0.6710436067037893, 0.5497004779019702)
_ROULETTE = 0.02


class Covered:
    """The covered samples of a camera, sorted by pixel, and their geometry and textures.

    pixels (P,): the pixels that any sample covers, flat indices; starts (P + 1,): where their samples begin.
    """

    def __init__(self, posed: BakedSurface, raster: Raster, samples: slice | Array) -> None:
        surface, faces = posed.surface, posed.faces
        self.posed, self.share = posed, 1.0 / raster.supersample**2
        pixel, face, weights = raster.pixel[samples], raster.face[samples], raster.barycentric[samples]
        self.pixels, first = np.unique(pixel, return_index=True)
        self.starts: Array = np.append(first, len(pixel)).astype(np.int64)
        self.corners: Array = faces[face].astype(np.int32)
        self.weights: Array = weights
        uvs, uv_faces = raster.mesh.topology.unwrapped
        uv = self._between(uvs[uv_faces[face]])
        self.position: Array = self._between(raster.mesh.vertices[self.corners])
        self.view: Array = unit_rows(raster.camera.centre - self.position).astype(np.float32)
        self.smooth: Array = unit_rows(self._between(raster.mesh.normals[self.corners])).astype(np.float32)
        tilted = self.smooth
        if surface.bump is not None:
            tilted = unit_rows(self.smooth - _slope(surface.bump, uv, raster, face)).astype(np.float32)
        self.normal: Array = _turned(tilted, self.view)
        self.facing: Array = dot(self.normal, self.view)
        self.albedo: Array = read(surface.albedo, uv).astype(np.float32)
        self.roughness: Array = np.clip(read(surface.roughness, uv), 0, 1).astype(np.float32)
        self.leaving: Array = (1 - posed.tables.at(self.facing, self.roughness)) / (
            1 - posed.tables.mean(self.roughness)
        )
        free_path = self._between(posed.free_path.astype(np.float32)[self.corners])
        self.local: Array = 1 - escaped(free_path, _FURROW)

    def _between(self, corners: Array) -> Array:
        """Values (S, C) from those at the corners (S, 3, C)."""
        first, second, third = self.weights.T[..., None]
        return first * corners[:, 0] + second * corners[:, 1] + third * corners[:, 2]

    @property
    def pigment(self) -> Array:
        """What of light under the surface comes out towards the camera, (S, 3) per steradian."""
        return self.albedo * (self.leaving * (self.share / np.pi))[:, None]

    def matrix(self, values: Array) -> csr_array:
        """From the vertices to the pixels (P, V): the sum over samples of interpolated values times `values` (S,)."""
        data = (self.weights * values[:, None]).ravel().astype(np.float32)
        shape = (len(self.pixels), len(self.posed.mesh.vertices))
        return csr_array((data, self.corners.ravel(), 3 * self.starts.astype(np.int32)), shape=shape)

    def sums(self, values: Array) -> Array:
        """Sums (P,) over the samples of each pixel."""
        return np.add.reduceat(values, self.starts[:-1])

    @property
    def owner(self) -> Array:
        """Which of `pixels` each sample belongs to, (S,)."""
        return np.arange(len(self.pixels)).repeat(np.diff(self.starts))


def picture(view: Covered, lit: Lit, skies: Sequence[Sky | None], per_place: int, seed: int) -> Array:
    """Radiance (L, P, 3) of the view's pixels under every light."""
    pigment = view.pigment
    image = np.stack([(view.matrix(pigment[:, c]) @ lit.leaves[c]).T for c in range(3)], axis=2).astype(np.float64)
    _tilt(view, lit, pigment, image)
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        single = [i for i, seen in enumerate(lit.seen) if seen is not None]
        for i, found in zip(single, threads.map(lambda i: _single(view, lit, i, pigment), single), strict=True):
            image[i] += found
        _mirrored(view, lit, skies, per_place, seed, image)
        bright = {i: sky for i, sky in enumerate(skies) if sky is not None and len(sky.slots)}
        aimed = threads.map(lambda i: _aimed(view, bright[i], image[i], per_place, seed), bright)
        for i, found in zip(bright, aimed, strict=True):
            image[i] += found
    return np.maximum(image, 0.0)


def _tilt(view: Covered, lit: Lit, pigment: Array, image: Array) -> None:
    """Add how relief shows in the diffuse light of environments."""
    if not lit.environments or view.normal is view.smooth:
        return
    tilt = view.normal - view.smooth
    for c in range(3):
        for axis in range(3):
            matrix = view.matrix(pigment[:, c] * view.local[:, c] * tilt[:, axis])
            found = matrix @ np.ascontiguousarray(lit.turns[:, c, axis])
            for k, i in enumerate(lit.environments):
                image[i, :, c] += found[:, k]


def _single(view: Covered, lit: Lit, i: int, pigment: Array) -> Array:
    """What the lobes mirror of a single light, and how relief shows in its diffuse light, (P, 3)."""
    light, seen = lit.lights[i], lit.seen[i]
    assert seen is not None
    tables = view.posed.tables
    visible = dot(view.weights, seen[view.corners])
    on = np.flatnonzero(visible > 0)
    result = np.zeros((len(view.pixels), 3))
    if not len(on):
        return result
    direction, falling = towards(light, view.position[on])
    falling = visible[on] * falling
    tilted = np.maximum(dot(view.normal[on], direction), 0)
    smooth = np.maximum(dot(view.smooth[on], direction), 0)
    along, roughness = dot(view.view[on], direction), view.roughness[on]
    glossy, relief = np.zeros((2, len(view.roughness)), np.float32)
    glossy[on] = falling * gloss(roughness, view.posed.surface.specular, tilted, view.facing[on], along)
    relief[on] = falling * (tilted * (1 - tables.at(tilted, roughness)) - smooth * (1 - tables.at(smooth, roughness)))
    shine = view.sums(glossy) * view.share
    for c in range(3):
        result[:, c] = view.sums(relief * pigment[:, c] * view.local[:, c]) + shine
    return result * colour(light)


def _mirrored(view: Covered, lit: Lit, skies: Sequence[Sky | None], per_place: int, seed: int, image: Array) -> None:
    """Add what the lobes mirror along sampled rays: other parts of the surface, and the skies."""
    posed = view.posed
    rays = posed.mesh.rays
    owner = view.owner
    rng = np.random.default_rng([seed, 3])
    turns = rng.random((len(view.pixels), 2), np.float32)[owner]
    rank = (np.arange(len(owner)) - view.starts[:-1][owner]).astype(np.float32)
    for k, which, count in _passes(view, per_place):
        u, v = ((turns[which, d] + (rank[which] * count + k) * _STEPS[d]) % 1.0 for d in range(2))
        direction, weight, density = _sampled(view, which, u, v)
        some = np.flatnonzero(weight > 0)
        on, direction = which[some], direction[some]
        hits = rays.cast(view.position[on] + view.smooth[on] * rays.epsilon, direction)
        weight, pixel, density = (weight * (view.share / count))[some], owner[on], density[some]
        hit, miss = np.flatnonzero(hits.hit), np.flatnonzero(~hits.hit)
        if lit.bounces:
            _add_skin(view, lit, pixel[hit], weight[hit], hits.face[hit], hits.barycentric[hit], image)
        direction, weight, pixel, density = direction[miss], weight[miss], pixel[miss], density[miss]
        for i, sky in enumerate(skies):
            if sky is not None:
                at = texels(direction, *sky.density.shape)
                found = sky.rest[at] + sky.bright[at] * (density / (density + sky.density[at]))[:, None]
                for c in range(3):
                    image[i, :, c] += np.bincount(pixel, found[:, c] * weight, minlength=len(view.pixels))


def _passes(view: Covered, per_place: int) -> Iterator[tuple[int, Array, Array]]:
    """One ray each of some samples at a time: its number, which samples, and how many rays each of them has in all."""
    edge = view.facing < _EDGE
    count = np.where(edge, _MORE * per_place, per_place).astype(np.float32)
    for k in range(_MORE * per_place):
        which = np.flatnonzero(count > k)
        yield k, which, count[which]


def _sampled(view: Covered, which: Array, u: Array, v: Array) -> tuple[Array, Array, Array]:
    """Directions (S, 3) from one of the lobes, BRDF times cosine over their density, and the density (S,)."""
    roughness, facing, frame = view.roughness[which], view.facing[which], view.normal[which]
    sharper, broader = alphas(roughness)
    first = u < WEIGHTS[0]
    alpha = np.where(first, sharper, broader)
    u = np.where(first, u / WEIGHTS[0], (u - WEIGHTS[0]) / WEIGHTS[1])
    x_axis = to_world(frame, np.broadcast_to(np.array([1, 0, 0], np.float32), frame.shape))
    y_axis = to_world(frame, np.broadcast_to(np.array([0, 1, 0], np.float32), frame.shape))
    local = np.stack([dot(x_axis, view.view[which]), dot(y_axis, view.view[which]), facing], axis=1)
    half = sample(alpha, local, u, v)
    out = 2 * dot(half, local)[:, None] * half - local
    cosine = np.maximum(out[:, 2], 0)
    light_view = dot(out, local)
    value = gloss(roughness, view.posed.surface.specular, cosine, facing, light_view)
    chance = np.maximum(density(roughness, cosine, facing, light_view), 1e-12)
    return to_world(frame, out), np.where(cosine > 0, value / chance, 0.0), chance


def _add_skin(
    view: Covered, lit: Lit, pixel: Array, weight: Array, face: Array, barycentric: Array, image: Array
) -> None:
    """Add light that leaves the surface where mirrored rays meet it."""
    posed = view.posed
    order = np.argsort(pixel, kind="stable")
    corners = posed.faces[face[order]].astype(np.int32)
    weights = barycentric[order] * weight[order, None] / np.pi
    starts = np.concatenate([[0], np.cumsum(3 * np.bincount(pixel, minlength=len(view.pixels)))]).astype(np.int32)
    radiosity = posed.radiosity
    for c in range(3):
        data = (weights * radiosity[corners, c]).astype(np.float32).ravel()
        shape = (len(view.pixels), len(posed.mesh.vertices))
        image[:, :, c] += (csr_array((data, corners.ravel(), starts), shape=shape) @ lit.leaves[c]).T


def _aimed(view: Covered, sky: Sky, so_far: Array, per_place: int, seed: int) -> Array:
    """What the lobes mirror of a map's bright texels (P, 3); faint shares are traced by chance, in proportion."""
    rays, owner = view.posed.mesh.rays, view.owner
    rng = np.random.default_rng([seed, 4])
    turns = rng.random((len(view.pixels), 4), np.float32)[owner]
    rank = (np.arange(len(owner)) - view.starts[:-1][owner]).astype(np.float32)
    threshold = _ROULETTE * so_far.sum(axis=1)[owner] + 1e-12
    result = np.zeros((len(view.pixels), 3))
    for k, which, count in _passes(view, per_place):
        turn = rank[which] * count + k
        direction, radiance = sky.aim(*((turns[which, d] + turn * _GOLDEN3[d]) % 1.0 for d in range(3)))
        some = np.flatnonzero(dot(view.normal[which], direction) > 0)
        on = which[some]
        direction, radiance, roughness, facing = direction[some], radiance[some], view.roughness[on], view.facing[on]
        cosine, along = dot(view.normal[on], direction), dot(view.view[on], direction)
        value = gloss(roughness, view.posed.surface.specular, cosine, facing, along)
        aimed = sky.density[texels(direction, *sky.density.shape)]
        light = radiance * (value * aimed / (aimed + density(roughness, cosine, facing, along)))[:, None]
        chance = np.minimum((light[:, 0] + light[:, 1] + light[:, 2]) / threshold[on], 1.0)
        kept = np.flatnonzero((turns[on, 3] + turn[some] * 0.6180339887498949) % 1.0 < chance)
        start = view.position[on[kept]] + view.smooth[on[kept]] * rays.epsilon
        free = kept[~rays.occluded(start, direction[kept])]
        light = light[free] * (view.share / count[some][free] / chance[free])[:, None]
        for c in range(3):
            result[:, c] += np.bincount(owner[on[free]], light[:, c], minlength=len(view.pixels))
    return result


def _turned(normal: Array, view: Array) -> Array:
    """Normals (S, 3) that the camera sees from behind, turned until it just sees their front."""
    facing = dot(normal, view)
    hidden = facing < _GRAZING
    if not hidden.any():
        return normal
    turned = normal.copy()
    turned[hidden] = unit_rows(normal[hidden] + (_GRAZING - facing[hidden, None]) * view[hidden])
    return turned


def _slope(bump: Array, uv: Array, raster: Raster, face: Array) -> Array:
    """Gradient (S, 3) of a relief texture along the surface, in metres per metre."""
    vertices, faces = raster.mesh.vertices, raster.mesh.topology.faces
    uvs, uv_faces = raster.mesh.topology.unwrapped
    corner, at = vertices[faces[face]], uvs[uv_faces[face]]
    edges, steps = corner[:, 1:] - corner[:, :1], at[:, 1:] - at[:, :1]
    determinant = steps[:, 0, 0] * steps[:, 1, 1] - steps[:, 0, 1] * steps[:, 1, 0]
    down, right = np.gradient(np.asarray(bump, np.float64))
    by_u, by_v = read(np.asarray(right), uv) * bump.shape[1], -read(np.asarray(down), uv) * bump.shape[0]
    rise = [steps[:, k, 0] * by_u + steps[:, k, 1] * by_v for k in range(2)]  # along the two edges
    normal = np.cross(edges[:, 0], edges[:, 1])
    squared = np.maximum((normal * normal).sum(axis=1, keepdims=True), 1e-30)
    slope = rise[0][:, None] * np.cross(edges[:, 1], normal) + rise[1][:, None] * np.cross(normal, edges[:, 0])
    return np.where(np.abs(determinant)[:, None] > 0, slope / squared, 0.0)
