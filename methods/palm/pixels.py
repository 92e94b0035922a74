"""Which pixels of a picture a step looks at: where single ones are, and a square patch about the hand."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion

from handbench.scene import Array

SHARES = (0.6, 0.3, 0.1)
"""Of single pixels: on the hand, near its edge, elsewhere (released code)."""


def near_edge(hand: Array, distance: int) -> Array:
    """Which pixels (h, w) are within `distance` pixels of the edge of a mask (h, w)."""
    return binary_dilation(hand, iterations=distance) & ~binary_erosion(hand, iterations=distance)


def square(hand: Array, side: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Rows and columns (side * side,) of a patch about a random pixel of a mask (h, w), row by row.

    About any pixel where the mask is empty. The picture is not smaller than the patch.
    """
    inside = np.flatnonzero(hand) if hand.any() else np.arange(hand.size)
    at = np.divmod(int(rng.choice(inside)), hand.shape[1])
    top, left = (int(np.clip(k - side // 2, 0, size - side)) for k, size in zip(at, hand.shape, strict=True))
    rows, columns = np.mgrid[top : top + side, left : left + side]
    return rows.ravel(), columns.ravel()
