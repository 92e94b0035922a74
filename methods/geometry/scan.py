"""What fully lit frames show: scans from depth maps, depth maps of the aligned neutral hand, pictures of the hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import maximum_filter, minimum_filter
from torch import Tensor

from handbench.errors import Unsupported
from handbench.scene import Array, Camera, Frame, Observation, needed
from handbench.scene.colour import unclipped_srgb

_SLOPE = 3.0  # depth over width: where a surface seems steeper, the pixels straddle an edge
_MARGIN = 1.3  # of a picture's side over the box of the key points
WINDOW = ((-0.14, 0.14), (-0.05, 0.23))
"""The part of the reference frame, x and y in metres, that the neutral hand's depth maps show."""
_DEPTH = 0.05  # metres that count as one in a depth map


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Surface points (N, 3) in metres, unit directions (N, 3) to their cameras, areas (N,) that their pixels cover."""

    points: Array
    seen_from: Array
    area: Array

    def moved(self, turn: Array, shift: Array, scale: float = 1.0) -> PointCloud:
        """Rotated, shifted, then enlarged about the origin."""
        return PointCloud((self.points @ turn.T + shift) * scale, self.seen_from @ turn.T, self.area * scale**2)


def point_cloud(frames: Sequence[tuple[Frame, Observation]]) -> PointCloud:
    """The points that the depth maps of a pose's frames show, without pixels on edges.

    Raises `Unsupported` for a frame without depth or without a hand.
    """
    parts = [_unprojected(frame, seen) for frame, seen in frames]
    return PointCloud(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("points", "seen_from", "area"))
    )


def _unprojected(frame: Frame, seen: Observation) -> PointCloud:
    if seen.depth is None:
        raise Unsupported(f"the geometry autoencoder needs depth maps as scans, and {frame.key} has no depth channel")
    camera, depth = frame.camera, seen.depth
    pixel = depth / np.sqrt(camera.K[0, 0] * camera.K[1, 1])
    steep = maximum_filter(depth, 3) - minimum_filter(depth, 3) > 2.0 * _SLOPE * pixel  # three pixels are two steps
    rows, columns = np.nonzero((needed(seen.alpha, "alpha") > 0.999) & (depth > 0) & ~steep)
    if not len(rows):
        raise Unsupported(f"the geometry autoencoder needs pictures of a hand, and {frame.key} shows none")
    points = camera.unproject(np.column_stack([columns, rows]) + 0.5, depth[rows, columns].astype(np.float64))
    back = camera.centre - points
    return PointCloud(
        points, back / np.linalg.norm(back, axis=1, keepdims=True), pixel[rows, columns].astype(np.float64) ** 2
    )


def depth_maps(aligned: PointCloud, size: int) -> Tensor:
    """Two orthographic depth maps and their coverage, (4, size, size), of a scan in the reference frame.

    Points seen from the palm's side (+z) and from the back go to maps of their own. Each point is shared by the four
    nearest cells by its area, so the maps change smoothly with it and do not depend on the recording's resolution.
    """
    (left, right), (low, high) = WINDOW
    x = (aligned.points[:, 0] - left) / (right - left) * size - 0.5
    y = (high - aligned.points[:, 1]) / (high - low) * size - 0.5
    weight = aligned.area * size**2 / ((right - left) * (high - low))
    maps = []
    for side in (1.0, -1.0):
        # a point at the very rim, where the side is in doubt, counts for neither
        share = weight * np.clip(4.0 * side * aligned.seen_from[:, 2], 0.0, 1.0)
        cover, depth = _splat(x, y, share, size), _splat(x, y, share * aligned.points[:, 2] / _DEPTH, size)
        maps += [depth / (cover + 0.1), cover / (cover + 0.1)]
    return torch.from_numpy(np.stack(maps).astype(np.float32))


def _splat(x: Array, y: Array, values: Array, size: int) -> Array:
    """Sums (size, size) of values (N,) at places (N,) in cells, shared bilinearly; what falls outside is lost."""
    total = np.zeros(size * size)
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    for dx in (0, 1):
        for dy in (0, 1):
            share = (1.0 - np.abs(x - column - dx)) * (1.0 - np.abs(y - row - dy)) * values
            c, r = column + dx, row + dy
            inside = (c >= 0) & (c < size) & (r >= 0) & (r < size)
            total += np.bincount(r[inside] * size + c[inside], share[inside], size * size)
    return total.reshape(size, size)


def square_picture(image: Array, camera: Camera, points: Array, size: int) -> Tensor:
    """The square (3, size, size) of a picture around key points (P, 3), as sRGB display values."""
    pixels, _ = camera.project(points)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    half = 0.5 * _MARGIN * float((high - low).max())
    steps = (torch.arange(size) + 0.5) / size * 2.0 - 1.0
    middle = (low + high) / 2.0
    x = (middle[0] + half * steps) / camera.width * 2.0 - 1.0
    y = (middle[1] + half * steps) / camera.height * 2.0 - 1.0
    grid = torch.stack([x[None].expand(size, -1), y[:, None].expand(-1, size)], dim=-1)[None].float()
    source = unclipped_srgb(torch.from_numpy(image.transpose(2, 0, 1).copy()))[None]
    return torch.nn.functional.grid_sample(source, grid, align_corners=False)[0]
