"""Numbers of others: key points in our order (the wrist, then each finger from knuckle to tip, thumb first), fits."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import InputError
from ...scene import Array, Camera

TIPS_FIRST = (20, *(4 * finger + 3 - k for finger in range(5) for k in range(4)))
"""Of 21 that list each finger from tip to knuckle, thumb first, and the wrist last."""


def shaped(table: Any, shape: tuple[int, ...], owner: str) -> Array:
    """The numbers of a file as an array of a shape. Raises `InputError` if it holds anything else."""
    try:
        found = np.array(table, np.float64)
        if found.size != np.prod(shape) or not np.isfinite(found).all():
            raise ValueError
    except (TypeError, ValueError) as error:
        wanted = " x ".join(map(str, shape))
        raise InputError(f"{owner} holds no {wanted} finite numbers; get it anew") from error
    return found.reshape(shape)


def projected(points: Array, camera: Camera) -> Array:
    """Points (K, 3) in the world as key points (K, 3) of a picture: sure where they are before the camera."""
    places, depth = camera.project(points)
    return np.c_[np.where(np.isfinite(places), places, 0.0), depth > 0]


def fields(table: Any, sizes: dict[str, int], owner: str) -> dict[str, Array]:
    """The fields of a fit, each of so many numbers, as arrays that cannot be written.

    Raises `InputError` for one that is missing, of another size, or not finite.
    """
    found = {}
    for name, size in sizes.items():
        try:
            value = np.asarray(table[name] if isinstance(table, dict) else None)
        except (KeyError, ValueError):  # of rows of different lengths
            value = np.zeros(0, bool)
        if value.dtype.kind not in "fiu" or value.size != size or not np.isfinite(value).all():
            raise InputError(f"{owner} has no {name} of {size} numbers; get it anew")
        found[name] = value.astype(np.float64).ravel()
        found[name].flags.writeable = False
    return found
