"""How much of each pixel a surface covers, and how that changes when its vertices move: exact, by the outline alone.

Let a line of the picture run from left to right. The number of surface layers above it changes only where it crosses
an edge whose triangles lie on one side (a fold, by two) or that has one triangle (a border, by one); at all other edges
a triangle ends and another begins. So the crossings with those few edges, in order, tell where the surface begins and
ends, whatever hides what. Coverage is exact along lines. Its derivative is an integral over the outline (Reynolds'
transport theorem): moving the outline by v adds the area ∮ v·n ds. With n·n = n_x² + n_y² it is summed over crossings
with rows, weighted by |n_x|, and with columns, weighted by |n_y|, so that no direction of the outline is badly sampled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..errors import InputError
from ..scene import Array, Camera

LINES = 4
"""Lines a pixel, in each direction."""


class EdgeTable:
    """The edges of triangles (F, 3) over shared vertices, made once a topology: `pairs` (E, 2), each edge once."""

    def __init__(self, faces: Array) -> None:
        self.faces = np.asarray(faces, dtype=np.int64)
        ends = self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        low, high = ends.min(axis=1), ends.max(axis=1)
        count = int(self.faces.max(initial=-1)) + 1
        keys, self._edge = np.unique(low * count + high, return_inverse=True)
        self.pairs: Array = np.stack([keys // max(count, 1), keys % max(count, 1)], axis=1)
        self._along = np.where(ends[:, 0] == low, 1, -1)  # whether its triangle runs along the edge or against it

    def steps(self, places: Array) -> Array:
        """By how many layers (E,) the right of each edge, looking along its pair, has more than the left."""
        a, b, c = (places[self.faces[:, k]] for k in range(3))
        (ux, uy), (vx, vy) = (b - a).T, (c - a).T
        turned = np.sign(ux * vy - uy * vx).repeat(3)
        return np.bincount(self._edge, turned * self._along, minlength=len(self.pairs)).astype(np.int64)


@dataclass(frozen=True)
class Outline:
    """Points of the visible outline of a surface in a picture, n in number.

    place (n, 2) in pixels; normal (n, 2) unit, out of the surface; length (n,) in pixels, of the outline that each
    stands for; ends (n, 2) vertices of the edge it is on and share (n,) of the second: the place is
    `(1 - share) places[ends[:, 0]] + share places[ends[:, 1]]`, and moves so.
    """

    place: Array
    normal: Array
    length: Array
    ends: Array
    share: Array


def outline(places: Array, edges: EdgeTable, width: int, height: int, lines: float = LINES) -> Outline:
    """The outline of a surface inside a picture; places (V, 2) are those of the vertices, `lines` a pixel."""
    return _scanned(places, edges, width, height, lines)[1]


def coverage(places: Tensor, edges: EdgeTable, width: int, height: int, lines: int = LINES) -> Tensor:
    """Alpha (height, width) in [0, 1] of a surface whose vertices are seen at places (V, 2) in pixels.

    Differentiable once in the places. Worked out in float64 on the CPU; alpha has the dtype and device of the places.
    Raises `InputError` for places that are not finite.
    """
    return _Coverage.apply(places, edges, width, height, lines)


def silhouette(vertices: Tensor, edges: EdgeTable, camera: Camera, lines: int = LINES) -> Tensor:
    """Alpha (H, W) of a surface with vertices (V, 3) in the world, differentiable once in them.

    Raises `InputError` if a vertex is not in front of the camera.
    """
    return coverage(seen_at(vertices, camera)[0], edges, camera.width, camera.height, lines)


def seen_at(points: Tensor, camera: Camera) -> tuple[Tensor, Tensor]:
    """Places (..., 2) in pixels and depth (...,) in metres of points (..., 3): `Camera.project` for tensors.

    Raises `InputError` if a point is not in front of the camera: it has no place.
    """
    pose = torch.tensor(camera.world_to_camera, dtype=points.dtype, device=points.device)
    seen = points @ pose[:, :3].T + pose[:, 3]
    depth = seen[..., 2]
    if not bool((depth > 0).all()):
        raise InputError(
            f"camera {camera.name!r}: part of the surface is not in front of the camera; "
            "move it, or check the world_to_camera"
        )
    pixels = seen @ torch.tensor(camera.K, dtype=points.dtype, device=points.device).T
    return pixels[..., :2] / depth[..., None], depth


class _Coverage(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, places: Tensor, edges: EdgeTable, width: int, height: int, lines: int) -> Tensor:
        given = places.detach().cpu().double().numpy()
        if not np.isfinite(given).all():
            raise InputError("coverage: places hold NaN or infinity; give finite vertices in front of the camera")
        alpha, ctx.outline = _scanned(given, edges, width, height, lines)
        ctx.count = len(given)
        return torch.from_numpy(alpha).to(places)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        found: Outline = ctx.outline
        column, row = found.place.T.astype(np.int64)
        pull = (gradient.cpu().double().numpy()[row, column] * found.length)[:, None] * found.normal
        parts = np.concatenate([(1.0 - found.share)[:, None] * pull, found.share[:, None] * pull])
        vertex = found.ends.T.ravel()
        moved = np.stack([np.bincount(vertex, part, minlength=ctx.count) for part in parts.T], axis=1)
        return torch.from_numpy(moved).to(gradient), None, None, None, None


def _scanned(places: Array, edges: EdgeTable, width: int, height: int, lines: float) -> tuple[Array, Outline]:
    """Alpha (height, width), the mean of what rows and columns tell, and the outline's points inside the picture."""
    steps = edges.steps(places)
    folds = np.flatnonzero(steps)
    pairs, steps = edges.pairs[folds], steps[folds]
    across, by_rows = _crossed(places, pairs, steps, width, height, lines)
    along, by_columns = _crossed(places[:, ::-1], pairs, -steps, height, width, lines)
    both = (by_rows, Outline(by_columns.place[:, ::-1], by_columns.normal[:, ::-1], *_rest(by_columns)))
    found = Outline(*(np.concatenate(parts) for parts in zip(*map(_fields, both), strict=True)))
    inside = ((found.place >= 0) & (found.place < (width, height))).all(axis=1)
    return (across + along.T) / 2, Outline(*(part[inside] for part in _fields(found)))


def _crossed(places: Array, pairs: Array, steps: Array, width: int, height: int, lines: float) -> tuple[Array, Outline]:
    """What rows tell: alpha, and the outline where they cross it."""
    start, end = places[pairs[:, 0]], places[pairs[:, 1]]
    down = end[:, 1] > start[:, 1]
    last = np.floor(height * lines)
    top, bottom = (
        np.clip(np.ceil(pick(start[:, 1], end[:, 1]) * lines - 0.5), 0, last).astype(np.int64)
        for pick in (np.minimum, np.maximum)
    )
    count = bottom - top  # an edge has the lines top <= line < bottom, so where edges meet a line crosses one
    edge = np.arange(len(pairs)).repeat(count)
    line = np.arange(len(edge)) - (np.cumsum(count) - count - top).repeat(count)
    y = (line + 0.5) / lines
    share = (y - start[edge, 1]) / (end[edge, 1] - start[edge, 1])
    x = (1.0 - share) * start[edge, 0] + share * end[edge, 0]

    order = np.argsort(line * (width + 4.0) + np.clip(x, -1.0, width + 1.0), kind="stable")
    line, x, y, edge, share = (values[order] for values in (line, x, y, edge, share))
    layers = np.cumsum(
        np.where(down, -steps, steps)[edge]
    )  # no line has any before its first crossing or after its last
    covered = np.concatenate([[False], layers > 0]).view(np.int8)
    change = np.diff(covered)
    kept = np.flatnonzero(change)
    line, x, y, edge, share, change = (values[kept] for values in (line, x, y, edge, share, change))

    row = np.minimum(y.astype(np.int64), height - 1)
    column = np.clip(x, 0.0, width)
    pixel = np.minimum(column.astype(np.int64), width - 1)
    part = column - pixel
    cell = row * (width + 1) + pixel
    sums = np.bincount(cell, change * (1.0 - part), minlength=height * (width + 1) + 1)
    sums += np.bincount(cell + 1, change * part, minlength=height * (width + 1) + 1)
    alpha = np.cumsum(sums[:-1].reshape(height, width + 1), axis=1)[:, :width] / lines

    run = end[edge] - start[edge]
    normal = np.stack([run[:, 1], -run[:, 0]], axis=1)
    normal *= (-change * np.sign(run[:, 1]) / np.linalg.norm(run, axis=1))[:, None]
    length = np.abs(normal[:, 0]) / lines
    return np.clip(alpha, 0.0, 1.0), Outline(np.stack([x, y], axis=1), normal, length, pairs[edge], share)


def _fields(found: Outline) -> tuple[Array, ...]:
    return found.place, found.normal, found.length, found.ends, found.share


def _rest(found: Outline) -> tuple[Array, Array, Array]:
    return found.length, found.ends, found.share
