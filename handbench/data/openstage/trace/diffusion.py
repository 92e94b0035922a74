"""Light that wanders under the skin: normalised diffusion between the points of a surface.

Light that enters at one point leaves at another, at distance r, with the density
R(r) = (exp(-r/d) + exp(-r/3d)) / (8 pi d r), which integrates to 1 over a plane (Christensen and Burley, "Approximate
reflectance profiles for efficient subsurface scattering", 2015). It is a quarter of a narrow lobe,
exp(-r/s) / (2 pi s r) with s = d, and three quarters of a wide one, s = 3d; each is one sparse matrix over points as
dense as it needs.
The straight way between two points, sunk a little into the flesh, must not leave it: nothing crosses a gap of air.
Rows are divided by what they find, so that even light stays even on thin parts and in creases.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from ....render.see.rays import RayScene
from ....scene import Array
from .levels import Level, Points, level

PROFILE = 3.6
"""Diffuse mean free paths to the scale d of the profile: 3.5 + 100 (A - 0.33)^4 for a medium of albedo A about 0.5."""

_LOBES = ((0.25, 1.0), (0.75, 3.0))
_REACH = 4.0
"""Lobes end at so many scales: 2 % of them lie beyond."""

_SUNK = 0.3


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs of points that flesh connects: first, second (P,) and their distance."""

    first: Array
    second: Array
    distance: Array


@dataclass(frozen=True, eq=False)
class _Lobe:
    """A lobe on its level: weights over the clusters (M, M)."""

    share: float
    level: Level
    weights: csr_array


@dataclass(frozen=True, eq=False)
class Diffusion:
    """The matrices of a posed surface: for each channel its lobes, and where (V,) the skin scatters."""

    channels: tuple[tuple[_Lobe, ...], ...]
    scatters: Array

    def apply(self, channel: int, arrived: Array) -> Array:
        """Light that leaves each vertex per area (V, L) float32, for light that arrived (V, L), of one channel."""
        lobes = self.channels[channel]
        if not lobes:
            return arrived
        wandered = np.zeros_like(arrived)
        for lobe in lobes:
            on = lobe.level
            wandered += np.float32(lobe.share) * (on.spread @ (lobe.weights @ (on.gather @ arrived)))
        return np.where(self.scatters[:, None], wandered, arrived)


def escaped(free_path: Array, radius: float) -> Array:
    """Share of light that leaves farther than a radius from where it entered, for mean free paths in metres."""
    scale = np.maximum(free_path / PROFILE, 1e-9)
    return sum(share * np.exp(-radius / (wide * scale)) for share, wide in _LOBES)


def diffusion(points: Points, free_path: Array, rays: RayScene) -> Diffusion:
    """The matrices of points for mean free paths (V, 3) in metres; light stays where those are 0."""
    scatters = (free_path > 0).any(axis=1)
    if not scatters.any():
        return Diffusion(((), (), ()), scatters)
    scale = np.maximum(free_path / PROFILE, 1e-6)
    fine = Points(points.positions, points.normals, points.areas * scatters)  # nothing comes from where light stays
    typical, longest = np.median(scale[scatters], axis=0), np.quantile(scale[scatters], 0.99, axis=0)
    kinds = [(channel, share, wide) for channel in range(3) for share, wide in _LOBES]
    steps = [_step(fine.spacing, float(typical[channel] * wide)) for channel, _, wide in kinds]
    levels = {step: level(fine, step) for step in sorted(set(steps))}
    reach = {step: 0.0 for step in levels}
    for step, (channel, _, wide) in zip(steps, kinds, strict=True):
        reach[step] = max(reach[step], _REACH * float(longest[channel]) * wide)
    pairs = {step: _pairs(levels[step].points, reach[step], rays) for step in levels}
    channels: tuple[list[_Lobe], ...] = ([], [], [])
    for step, (channel, share, wide) in zip(steps, kinds, strict=True):
        on = levels[step]
        weights = _weights(on.points, pairs[step], (on.gather @ scale[:, channel]) * wide)
        channels[channel].append(_Lobe(share, on, weights))
    return Diffusion(tuple(map(tuple, channels)), scatters)


def _step(finest: float, scale: float) -> float:
    """How far apart the points of a lobe are: about its scale, in powers of 2; 0 where all vertices are wanted."""
    power = round(np.log2(scale / finest))
    return finest * 2.0**power if power >= 0 else 0.0


def _weights(points: Points, pairs: _Pairs, scale: Array) -> csr_array:
    """Rows (M, M) of a lobe: what each point gets from itself, within its own area, and from others; they sum to 1."""
    radius = np.sqrt(points.areas / np.pi)
    count = np.arange(len(radius))
    near = pairs.distance < _REACH * np.maximum(scale[pairs.first], scale[pairs.second])
    first, second, distance = pairs.first[near], pairs.second[near], pairs.distance[near]
    rows, columns = np.concatenate([first, second]), np.concatenate([second, first])
    distance, own = np.concatenate([distance, distance]), scale[rows]
    values = points.areas[columns] * np.exp(-distance / own) / (2 * np.pi * own * distance)
    matrix = coo_array(
        (
            np.concatenate([values, 1 - np.exp(-radius / scale) + 1e-9]).astype(np.float32),
            (np.concatenate([rows, count]).astype(np.int32), np.concatenate([columns, count]).astype(np.int32)),
        ),
        shape=(len(radius), len(radius)),
    )
    matrix.has_canonical_format = True  # no pair is there twice, so nothing needs sorting
    matrix = matrix.tocsr()
    total = np.add.reduceat(matrix.data.astype(np.float64), matrix.indptr[:-1])
    matrix.data /= np.repeat(total, np.diff(matrix.indptr)).astype(np.float32)
    return matrix


def _pairs(points: Points, reach: float, rays: RayScene) -> _Pairs:
    """Pairs within reach whose straight way, sunk into the flesh, meets no surface."""
    tree = cKDTree(points.positions)
    first, second = tree.query_pairs(reach, output_type="ndarray").T
    apart = points.positions[second] - points.positions[first]
    distance = np.linalg.norm(apart, axis=1)
    doubtful = _doubtful(points, first, second, apart, distance)
    depth = 0.4 * _thickness(points, rays)
    a, b = first[doubtful], second[doubtful]
    sunk = _SUNK * distance[doubtful]
    start = points.positions[a] - points.normals[a] * np.minimum(sunk, depth[a])[:, None]
    end = points.positions[b] - points.normals[b] * np.minimum(sunk, depth[b])[:, None]
    keep = np.ones(len(first), bool)
    keep[doubtful] = ~rays.occluded(start, end - start, 1.0)
    keep &= distance > 0
    return _Pairs(first[keep], second[keep], distance[keep])


def _doubtful(points: Points, first: Array, second: Array, apart: Array, distance: Array) -> Array:
    """Indices of pairs that may have air between them: not neighbours of about one plane."""
    ahead = np.einsum("pc,pc->p", points.normals[first], apart)
    back = -np.einsum("pc,pc->p", points.normals[second], apart)
    alike = np.einsum("pc,pc->p", points.normals[first], points.normals[second])
    flat = (np.maximum(ahead, back) < 0.3 * distance) & (alike > 0.7) & (distance < 4 * points.spacing)
    return np.flatnonzero(~flat)


def _thickness(points: Points, rays: RayScene) -> Array:
    """Metres of flesh under each point, straight down; infinite on an open surface."""
    packed = rays._rays(points.positions - points.normals * rays.epsilon, -points.normals)
    return rays.distances(packed)
