"""Environment maps: equirectangular radiance (H, W, 3), exact in solid angle and power.

Texel (i, j) spans polar angles theta in [i, i+1] pi/H from +y and azimuths phi in [j, j+1] 2 pi/W; its centre
looks to (sin theta sin phi, cos theta, -sin theta cos phi). So the left border looks to -z, the first quarter
to +x, the middle to +z and the third quarter to -x: the picture is seen from inside, not mirrored.
Radiance is constant within a texel.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array

from ..errors import InputError
from ..scene import Array, Environment

if TYPE_CHECKING:
    from torch import Tensor


def directions(height: int, width: int, rows: slice = slice(None)) -> Array:
    """Unit directions to the centres of the texels, (H, W, 3) float64; of some rows if asked."""
    theta = ((np.arange(height)[:, None] + 0.5) * (np.pi / height))[rows]
    phi = (np.arange(width) + 0.5) * (2.0 * np.pi / width)
    up = np.broadcast_to(np.cos(theta), (len(theta), width))
    return np.stack([np.sin(theta) * np.sin(phi), up, -np.sin(theta) * np.cos(phi)], axis=-1)


def places(direction: Array, height: int, width: int) -> tuple[Array, Array]:
    """Where unit directions (..., 3) point to in a map, in rows (...) and columns (...): texels begin at whole numbers,
    their centres are half a texel further."""
    x, y, z = np.moveaxis(direction, -1, 0)
    row = np.arccos(np.clip(y, -1.0, 1.0)) / np.pi * height
    return row, np.arctan2(x, -z) / (2.0 * np.pi) % 1.0 * width


def places_of(direction: Tensor, height: int, width: int) -> tuple[Tensor, Tensor]:
    """`places` of a tensor, where it lies; differentiable but at the poles."""
    x, y, z = direction.unbind(-1)
    row = y.clamp(-1.0, 1.0).acos() / np.pi * height
    return row, x.atan2(-z) / (2.0 * np.pi) % 1.0 * width


def texels(direction: Array, height: int, width: int) -> tuple[Array, Array]:
    """Row and column of the texels that unit directions (..., 3) point into, int (...)."""
    row, column = places(np.asarray(direction, dtype=np.float64), height, width)
    return np.floor(row).astype(int).clip(0, height - 1), np.floor(column).astype(int).clip(0, width - 1)


def solid_angles(height: int, width: int) -> Array:
    """Solid angles of the texels, (H, W) float64 steradians; their sum is 4 pi."""
    # cos a - cos b as a product: the difference would lose digits at the poles
    bands = 2.0 * np.sin(0.5 * np.pi / height) * np.sin((np.arange(height) + 0.5) * (np.pi / height))
    return np.repeat(bands[:, None], width, axis=1) * (2.0 * np.pi / width)


def resize(environment: Environment, height: int, width: int) -> Environment:
    """The map at another size: each texel is the mean radiance over its solid angle, so power is kept.

    The same bits whatever the number of threads. Raises `InputError` for a size below 1 x 1.
    """
    if height < 1 or width < 1:
        raise InputError(f"environment {environment.name!r} cannot have {height}x{width} texels; give at least 1x1")
    old_height, old_width = environment.radiance.shape[:2]
    if (old_height, old_width) == (height, width):
        return environment
    rows, columns = _shares(height, width, old_height, old_width)
    banded = (rows @ environment.radiance.reshape(old_height, -1)).reshape(height, old_width, 3)
    turned = columns @ banded.swapaxes(0, 1).reshape(old_width, -1)
    return Environment(environment.name, turned.reshape(width, height, 3).swapaxes(0, 1))


@lru_cache(maxsize=8)
def _shares(height: int, width: int, old_height: int, old_width: int) -> tuple[csr_array, csr_array]:
    """`_overlaps` of rows, which are even in solid angle, and of columns: the same for all maps of a size."""
    rows = (-np.cos(np.linspace(0.0, np.pi, n + 1)) for n in (height, old_height))
    return _overlaps(*rows), _overlaps(*(np.linspace(0.0, 1.0, n + 1) for n in (width, old_width)))


def _overlaps(new: Array, old: Array) -> csr_array:
    """The share of each old interval in each new one, (new, old); intervals between increasing edges.

    Sparse, as few overlap; and its products are summed in one order, unlike a dense one's, which threads share out.
    """
    low = np.maximum(new[:-1, None], old[None, :-1])
    high = np.minimum(new[1:, None], old[None, 1:])
    return csr_array(np.maximum(high - low, 0.0) / np.diff(new)[:, None])


def rotate(environment: Environment, angle: float) -> Environment:
    """The environment turned by `angle` radians about +y (right-handed: +z goes to +x at a quarter turn).

    Texels are shared between two columns where the turn is no whole number of columns; power is kept.
    Raises `InputError` for an angle that is NaN or infinite.
    """
    if not np.isfinite(angle):
        raise InputError(f"environment {environment.name!r} cannot be turned by {angle} radians; give a finite angle")
    width = environment.radiance.shape[1]
    shift = -angle / (2.0 * np.pi) * width  # azimuth here falls under a right-handed turn
    if abs(shift - round(shift)) < 1e-9 * width:  # rounding must not leak light into dark texels
        shift = round(shift)
    whole = int(np.floor(shift))
    part = shift - whole
    radiance = environment.radiance.astype(np.float64)
    turned = (1.0 - part) * np.roll(radiance, whole, axis=1) + part * np.roll(radiance, whole + 1, axis=1)
    return Environment(environment.name, turned)


def to_directional(
    environment: Environment, height: int = 16, width: int = 32, dark: bool = False
) -> tuple[Array, Array]:
    """The map as distant lights: unit directions (N, 3) and irradiance (N, 3) float64; dark texels are left out.

    Each texel of the reduced map is a light at its centre whose irradiance is radiance times solid angle; `dark`
    keeps those without any.
    """
    small = resize(environment, height, width)
    where = directions(height, width).reshape(-1, 3)
    power = (small.radiance.astype(np.float64) * solid_angles(height, width)[..., None]).reshape(-1, 3)
    if not dark:
        lit = power.any(axis=1)
        where, power = where[lit], power[lit]
    return where, power
