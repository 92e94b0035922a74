"""Angles between directions."""

from __future__ import annotations

import numpy as np

from handbench.scene import Array


def angles(one: Array, other: Array) -> Array:
    """Degrees (...) between directions (..., 3) of any length: 0 exactly for equal ones, 180 for opposite.

    From sine and cosine, as an arc cosine alone turns rounding into hundredths of a degree. NaN for a zero vector.
    """
    sine, cosine = np.linalg.norm(np.cross(one, other), axis=-1), (one * other).sum(axis=-1)
    return np.where((sine == 0.0) & (cosine == 0.0), np.nan, np.degrees(np.arctan2(sine, cosine)))
