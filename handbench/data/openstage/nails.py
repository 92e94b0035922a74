"""Nails: plates with edges, folds of skin around, lunula, free edge; bare or polished."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...scene import Array
from .noise import NoiseFields
from .places import Places, smoothstep

_LUNULA = np.array([1.0, 0.7, 0.6, 0.4, 0.15])  # how much of it shows, thumb to little finger


@dataclass(frozen=True)
class NailLook:
    """shape 0 (oval) … 1 (square), length 0 (bitten) … 1 (long), lunula and ridges 0 … 1.

    polish: linear RGB of nail polish, None for bare nails; tips: only the free edge is polished.
    """

    shape: float = 0.5
    length: float = 0.4
    lunula: float = 0.6
    ridges: float = 0.4
    polish: tuple[float, float, float] | None = None
    tips: bool = False


@dataclass(frozen=True, eq=False)
class Nails:
    """Per texel (N,), 0 … 1: plate, painted (polish), free (edge beyond the bed), lunula, band (the rosy line before
    the free edge), fold (the groove around the plate), rim (the raised skin around), cuticle; ridges about -1 … 1."""

    plate: Array
    painted: Array
    free: Array
    lunula: Array
    band: Array
    fold: Array
    rim: Array
    cuticle: Array
    ridges: Array


def nails(at: Places, look: NailLook, noise: NoiseFields) -> Nails:
    """The nails of all fingers."""
    root, across = at.nail_along, at.nail_across
    power = np.where(root > 0, 2.3 + 2.0 * look.shape, 2.6)  # the root is round on everybody
    edge = (np.abs(root) ** power + np.abs(across) ** power) ** (1 / power)
    near = (at.facing < 0.25) & (edge > 0) & (root > -2.0) & (at.finger >= 0)
    edge = np.where(near, edge, np.float32(9)).astype(np.float32)
    edge[near] += 0.015 * noise.field(at.position[near], 1.2e-3)
    plate = smoothstep(1.02, 0.96, edge)
    free_from = 0.86 - 0.34 * look.length
    free = smoothstep(-0.035, 0.035, root - free_from + 0.16 * across**2) * plate
    band = np.exp(-(((root - free_from + 0.16 * across**2 + 0.07) / 0.05) ** 2)) * plate
    shows = look.lunula * _LUNULA[np.maximum(at.finger, 0)]
    lunula = smoothstep(0.04, -0.06, root + 0.86 - 0.35 * shows + 0.3 * across**2) * plate * (shows > 0.1)
    ridges = np.zeros(len(plate), np.float32)
    on = plate > 0
    lines = np.stack([across * 4e-3, at.finger * 1.0, 0.03 * root * 4e-3], axis=1)[on]
    ridges[on] = look.ridges * noise.field(lines, 0.35e-3)
    painted = np.zeros(len(plate), np.float32)
    if look.polish is not None:
        start = free_from - 0.02 if look.tips else -0.93
        painted = smoothstep(-0.03, 0.03, root - start + (0.16 if look.tips else -0.1) * across**2) * plate
        painted *= smoothstep(1.0, 0.96, edge)
    return Nails(
        plate,
        painted,
        free,
        lunula,
        band,
        fold=np.exp(-(((edge - 1.03) / 0.05) ** 2)) * (root < 0.75),
        rim=np.exp(-(((edge - 1.2) / 0.11) ** 2)) * (root < 0.7),
        cuticle=np.exp(-(((edge - 1.0) / 0.035) ** 2)) * smoothstep(-0.3, -0.7, root),
        ridges=ridges,
    )
