"""The part of a picture that shows the hand, small enough to be drawn over and over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_erosion

from handbench.errors import Unsupported
from handbench.scene import Array, Camera


@dataclass(frozen=True, eq=False)
class Crop:
    """A camera that sees only the hand, the premultiplied linear image (h, w, 3) float32 and the mask (h, w)."""

    camera: Camera
    image: Array
    alpha: Array

    @staticmethod
    def of(camera: Camera, image: Array, alpha: Array, side: int, margin: float = 0.08) -> Crop:
        """The box of the mask with a margin (of its longer side), whose longer side has at most `side` pixels.

        Pixels are averaged in squares. Raises `Unsupported` for an empty mask.
        """
        rows, columns = np.nonzero(alpha > 0.5)
        if not len(rows):
            raise Unsupported("the mask of an enrolled picture is empty")
        low = np.array([columns.min(), rows.min()])
        high = np.array([columns.max(), rows.max()]) + 1
        space = int(np.ceil(margin * (high - low).max()))
        low, high = np.maximum(low - space, 0), np.minimum(high + space, (camera.width, camera.height))
        times = max(1, int(np.ceil((high - low).max() / side)))
        width, height = -(-(high - low) // times)
        missing = [times * size - part for size, part in zip((height, width), (high - low)[::-1], strict=True)]
        box = np.s_[low[1] : high[1], low[0] : high[0]]

        def small(values: Array) -> Array:
            padded = np.pad(values[box], [(0, m) for m in missing] + [(0, 0)] * (values.ndim - 2))
            return padded.reshape(height, times, width, times, *values.shape[2:]).mean(axis=(1, 3)).astype(np.float32)

        shift = np.array([[1, 0, -low[0]], [0, 1, -low[1]], [0, 0, 1]])
        K = np.diag([1 / times, 1 / times, 1.0]) @ shift @ camera.K
        return Crop(Camera(camera.name, width, height, K, camera.world_to_camera), small(image), small(alpha))

    def inner(self, rounds: int, size: int = 3) -> Array:
        """Where the mask (h, w) bool is whole and remains so when its edge is eaten `rounds` times by size x size."""
        whole = self.alpha > 0.99
        return binary_erosion(whole, np.ones((size, size)), iterations=rounds) if rounds else whole
