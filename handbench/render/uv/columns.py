"""Vectors as columns, (3, n): numpy's sums over rows of three are several times slower than over three long rows."""

from __future__ import annotations

import numpy as np

from ...scene import Array


def at_corners(values: Array, faces: Array) -> list[Array]:
    """Values (V, C) at each of the three corners of faces (F, 3), (C, F) each."""
    channels = np.ascontiguousarray(values.T)
    places = np.ascontiguousarray(faces.T, dtype=np.intp)
    # channel by channel: numpy's take along the last axis of a matrix is six times slower
    return [np.stack([channel[corner] for channel in channels]) for corner in places]


def weighted(weights: Array, values: list[Array]) -> Array:
    """The sum of three values (C, n) by weights (3, n)."""
    return weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2]


def inner(a: Array, b: Array) -> Array:
    """Inner products (n,) of columns."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Array, b: Array) -> Array:
    """Cross products (3, n) of columns."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def unit_columns(vectors: Array) -> Array:
    """Columns (3, n) made unit; zero stays zero."""
    length = np.sqrt(inner(vectors, vectors))
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
