"""Light that wanders under the skin: normalised diffusion between the points of a surface.

Light that enters at one point leaves at another, at distance r, with the density
R(r) = (exp(-r/d) + exp(-r/3d)) / (8 pi d r), which integrates to 1 over a plane (Christensen and Burley, "Approximate
reflectance profiles for efficient subsurface scattering", 2015). It is a quarter of a narrow lobe,
exp(-r/s) / (2 pi s r) with s = d, and three quarters of a wide one, s = 3d; each is one sparse matrix over points as
dense as it needs.
The straight way between two points, sunk a little into the flesh, must not leave it: nothing crosses a gap of air.

That profile is of a thick flat block. Straight through thin flesh goes more: a slab of thickness t passes about
C exp(-t/l) of what it reflects, l being the diffuse mean free path (the diffusion approximation). So pairs on facing
sides, whose way dives under both by the cosine c, take the profile times 1 - c, and
C c exp(-r/l) (1/l + 1/r) / (2 pi r), whose integral over a slab is C exp(-t/l). The profile is divided by what it
finds, so that even light stays even in creases; of what comes through, as much is taken off as surface albedo 1 asks
for: then nothing is gained, and where much is absorbed, thin parts are brighter, as they absorb less.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.spatial import cKDTree

from ....render.see.rays import RayScene
from ....scene import Array
from .gloss import dot
from .levels import Level, Points, level

SKIN_SCATTERING = 900.0
"""Reduced scattering of skin per metre (Jensen et al., "A practical model for subsurface light transport", 2001)."""

PROFILE = 3.6
"""Diffuse mean free paths to the scale d of the profile: 3.5 + 100 (A - 0.33)^4 for a medium of albedo A about 0.5."""

_LOBES = ((0.25, 1.0), (0.75, 3.0))
_REACH = 4.0
"""Lobes end at so many scales: 2 % of them lie beyond."""

_BLUR = 0.33
"""Variance along an axis of gathering to clusters and spreading from them, in squares of their spacing."""

_SUNK = 0.3


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs of points that flesh connects: first, second (P,), their distance, how steeply the way dives under both."""

    first: Array
    second: Array
    distance: Array
    dive: Array


@dataclass(frozen=True, eq=False)
class _Lobe:
    """A lobe on its level: weights over the clusters (M, M)."""

    level: Level
    weights: csr_array


@dataclass(frozen=True, eq=False)
class Diffusion:
    """The matrices of a posed surface: lobes of each channel; what is kept (V, 3); where (V,) the skin scatters."""

    channels: tuple[tuple[_Lobe, ...], ...]
    kept: Array
    scatters: Array

    def apply(self, channel: int, arrived: Array) -> Array:
        """Light that leaves each vertex per area (V, L) float32, for light that arrived (V, L), of one channel."""
        lobes = self.channels[channel]
        if not lobes:
            return arrived
        wandered = np.zeros_like(arrived)
        for lobe in lobes:
            on = lobe.level
            wandered += on.spread @ (lobe.weights @ (on.gather @ arrived))
        return np.where(self.scatters[:, None], wandered * self.kept[:, channel, None], arrived)


def escaped(free_path: Array, radius: float) -> Array:
    """Share of light that leaves farther than a radius from where it entered, for mean free paths in metres."""
    scale = np.maximum(free_path / PROFILE, 1e-9)
    return np.asarray(sum(share * np.exp(-radius / (wide * scale)) for share, wide in _LOBES))


def diffusion(points: Points, free_path: Array, albedo: Array, rays: RayScene) -> Diffusion:
    """The matrices of points for mean free paths (V, 3) in metres and albedo (V, 3); light stays where paths are 0."""
    scatters = np.asarray((free_path > 0).any(axis=1))
    kept = np.ones(free_path.shape, np.float32)
    if not scatters.any():
        return Diffusion(((), (), ()), kept, scatters)
    scale = np.maximum(free_path / PROFILE, 1e-6)
    fine = Points(points.positions, points.normals, points.areas * scatters)  # nothing comes from where light stays
    typical, longest = np.median(scale[scatters], axis=0), np.quantile(scale[scatters], 0.99, axis=0)
    kinds = [(channel, share, wide) for channel in range(3) for share, wide in _LOBES]
    steps = [_step(fine.spacing, float(typical[channel] * wide)) for channel, _, wide in kinds]
    reach: dict[float, float] = {}
    for step, (channel, _, wide) in zip(steps, kinds, strict=True):
        reach[step] = max(reach.get(step, 0.0), _REACH * float(longest[channel]) * wide)

    def clustered(step: float) -> tuple[Level, _Pairs]:
        on = level(fine, step)
        return on, _pairs(on.points, reach[step], rays)

    def lobe(step: float, kind: tuple[int, float, float]) -> tuple[_Lobe, Array | None]:
        channel, share, wide = kind
        on, near = levels[step]
        local = on.gather @ scale[:, channel]
        sharper = _unblurred(local * wide, on.points.spacing if step else 0.0)
        weights = _profile(on.points, near, sharper) * np.float32(share)
        if wide == 1:
            return _Lobe(on, weights), None
        through = _through(on.points, near, local * PROFILE)
        return _Lobe(on, weights + through), on.spread @ np.asarray(through.sum(axis=1))

    channels: tuple[list[_Lobe], ...] = ([], [], [])
    with ThreadPoolExecutor(os.cpu_count()) as threads:
        levels = dict(zip(reach, threads.map(clustered, reach), strict=True))
        for (channel, _, _), (made, extra) in zip(kinds, threads.map(lobe, steps, kinds), strict=True):
            channels[channel].append(made)
            if extra is not None:
                kept[:, channel] = 1 / (1 + np.clip(albedo[:, channel], 0, 1) * extra)
    return Diffusion(tuple(map(tuple, channels)), kept, scatters)


def _step(finest: float, scale: float) -> float:
    """How far apart the points of a lobe are: about 0.9 of its scale, in powers of sqrt(2) mm; 0 for all vertices."""
    step = max(1e-3 * 2.0 ** (0.5 * round(2 * np.log2(0.9e3 * scale))), finest)
    return step if step < 1.5 * scale else 0.0


def _unblurred(scale: Array, spacing: float) -> Array:
    """The scale of a lobe whose spread, with that of gathering to clusters and spreading from them, is as wanted."""
    return np.sqrt(np.maximum(scale * scale - _BLUR * spacing * spacing, 0.1 * scale * scale))


def _profile(points: Points, pairs: _Pairs, scale: Array) -> csr_array:
    """Rows (M, M) of a lobe: what each point gets from itself, within its own area, and from others; they sum to 1."""
    radius = np.sqrt(points.areas / np.pi)
    near = pairs.distance < _REACH * np.maximum(scale[pairs.first], scale[pairs.second])
    rows, columns, distance, dive = _both_ways(pairs, near)
    own = scale[rows]
    values = points.areas[columns] * np.exp(-distance / own) / (2 * np.pi * own * distance) * (1 - dive)
    every = np.arange(len(radius), dtype=np.int32)
    matrix = _sparse(
        np.concatenate([values, 1 - np.exp(-radius / scale) + 1e-9]),
        np.concatenate([rows, every]),
        np.concatenate([columns, every]),
        len(radius),
    )
    total = np.add.reduceat(matrix.data.astype(np.float64), matrix.indptr[:-1])
    matrix.data /= np.repeat(total, np.diff(matrix.indptr)).astype(np.float32)
    return matrix


def _through(points: Points, pairs: _Pairs, free_path: Array) -> csr_array:
    """What each point gets straight through the flesh from facing sides (M, M), where the profile gives 1 in all."""
    rows, columns, distance, dive = _both_ways(pairs, pairs.dive > 0)
    own = free_path[rows]
    faded = np.exp(-distance / own)
    passed = _passed(own)
    values = passed / (1 + (passed - 1) * faded) * dive * faded * (1 / own + 1 / distance) / (2 * np.pi * distance)
    return _sparse(points.areas[columns] * values, rows, columns, len(points.areas))


def _passed(free_path: Array) -> Array:
    """C: what a thick slab passes over exp(-t/l) and over what it reflects, for skin of mean free paths in metres.

    A fit to random walks through slabs of 1.5 to 6 mm (`benchmarks/scattering.py`).
    """
    return np.maximum(8.0 * (free_path * SKIN_SCATTERING) ** -1.1, 1.0)


def _both_ways(pairs: _Pairs, chosen: Array) -> tuple[Array, Array, Array, Array]:
    """Rows, columns, distance and dive of the chosen pairs, each one from first to second and back."""
    first, second = pairs.first[chosen], pairs.second[chosen]
    distance, dive = pairs.distance[chosen], pairs.dive[chosen]
    return (
        np.concatenate([first, second]),
        np.concatenate([second, first]),
        np.concatenate([distance, distance]),
        np.concatenate([dive, dive]),
    )


def _sparse(values: Array, rows: Array, columns: Array, size: int) -> csr_array:
    """A square matrix in float32 whose entries are all at different places."""
    matrix = coo_array((values.astype(np.float32), (rows, columns)), shape=(size, size))
    matrix.has_canonical_format = True  # saves sorting
    return matrix.tocsr()


def _pairs(points: Points, reach: float, rays: RayScene) -> _Pairs:
    """Pairs within reach whose straight way, sunk into the flesh, meets no surface."""
    first, second = cKDTree(points.positions).query_pairs(reach, output_type="ndarray").T.astype(np.int32)
    positions, normals = points.positions.astype(np.float32), points.normals.astype(np.float32)
    apart = positions[second] - positions[first]
    distance = np.sqrt(dot(apart, apart))
    unit = apart / np.maximum(distance, 1e-12)[:, None]
    ahead, back = dot(normals[first], unit), -dot(normals[second], unit)
    flat = (np.maximum(ahead, back) < 0.3) & (np.abs(ahead + back) < 0.7) & (distance < 4 * points.spacing)
    doubtful = np.flatnonzero(~(flat & (dot(normals[first], normals[second]) > 0.7)))
    keep = distance > 0
    keep[doubtful] &= ~_blocked(points, first[doubtful], second[doubtful], distance[doubtful], rays)
    dive = np.sqrt(np.maximum(-ahead, 0) * np.maximum(-back, 0))
    return _Pairs(first[keep], second[keep], distance[keep], dive[keep])


def _blocked(points: Points, first: Array, second: Array, distance: Array, rays: RayScene) -> Array:
    """Whether the ways between pairs leave the flesh, though they are sunk as deep as light wanders or flesh allows."""
    depth = 0.4 * _thickness(points, rays)
    start, end = (
        points.positions[each] - points.normals[each] * np.minimum(_SUNK * distance, depth[each])[:, None]
        for each in (first, second)
    )
    return rays.occluded(start, end - start, 1.0)


def _thickness(points: Points, rays: RayScene) -> Array:
    """Metres of flesh under each point, straight down; infinite on an open surface."""
    packed = rays._rays(points.positions - points.normals * rays.epsilon, -points.normals)
    return rays.distances(packed)
