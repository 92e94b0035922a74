"""What a hand in a picture costs: how far its key points, its outline and its surface are from those seen.

The terms are L1 norms, brought down by iteratively reweighted least squares: |r| is below r²/2|r₀| + |r₀|/2 and
touches it at r₀. The mask's is the area between two outlines, which is the distance from one to the other summed along
it; its derivative is the boundary integral of `render.silhouette`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp
import torch

from ...render.silhouette import EdgeTable, coverage, outline
from ...scene import Array
from .picture import CloseUp, sampled
from .placed import Placed
from .quadratic import Quadratic
from .rig import PosedRig, Rest
from .space import LIMIT, Space
from .told import PoseNoise, told_pose


@dataclass(frozen=True)
class TermWeights:
    """What the terms of the objective weigh.

    key_points: of their mean distance, where the close-up's longer side is 8 (as in UHM's heat maps of 8 x 8); mask: of
    the mean over the close-up's pixels of the difference of alphas; depth: of the mean distance to the measured
    surface in metres: 1, 50 and 100 (URHand supp. Sec. 3). pose and shape: of squared standard deviations; limits: of
    squared degrees beyond the joints' limits; told: of squared standard deviations (`tracker`) from a pose that the
    picture brings.
    Distances beyond `mask_reach` (pixels) and `depth_reach` (metres) pull no more: what is there is not the hand.
    """

    key_points: float = 1.0
    mask: float = 50.0
    depth: float = 100.0
    pose: float = 0.002
    shape: float = 0.004
    limits: float = 0.05
    told: float = 0.002
    mask_reach: float = 6.0
    depth_reach: float = 0.015
    tracker: PoseNoise = field(default_factory=PoseNoise)

    @property
    def far(self) -> TermWeights:
        """The same with four times the reach, for hands that are not yet in place."""
        return replace(self, mask_reach=4 * self.mask_reach, depth_reach=4 * self.depth_reach)


_POINT, _PIXEL, _METRE = 0.5, 0.5, 1e-3  # residuals below which L1 turns into L2
_SURFACE = 1000  # vertices, about, whose depth is compared where they are seen; always the same
_NEAR = 0.008  # metres behind the nearest vertex of a cell of 4 x 4 pixels: still visible


class Objective:
    """The cost of hands in close-ups."""

    def __init__(self, space: Space, views: Sequence[CloseUp], weights: TermWeights) -> None:
        self.space, self.views, self.weights = space, tuple(views), weights
        self._edges = EdgeTable(space.rig.faces)
        self._told = {view: told_pose(space, view) for view in self.views}

    def of(self, view: CloseUp, hand: Placed, rest: Rest) -> Quadratic:
        """The terms of one picture: pose, placement and shape in one vector (6 + F + K,)."""
        space, weights = self.space, self.weights
        posed = space.rig.pose(rest, space.turns(hand.angles)[None], space.free)
        points, motion = moving(posed, hand)
        total = Quadratic(0.0, np.zeros(motion.shape[-1]), np.zeros((motion.shape[-1],) * 2))
        count = space.rig.vertices
        if points[:, 2].min() < 0.01:  # metres in front of the camera: no picture
            return replace(total, cost=np.inf)
        self._key_points(total, view, points, motion)
        fine = space.rig.fine @ points[:count]
        coarse = motion[:count].reshape(count, -1)
        if view.outside is not None and weights.mask:
            self._mask(total, view, fine, coarse)
        if view.depth is not None and weights.depth:
            self._depth(total, view, fine, coarse)
        self._pose(total, hand.angles)
        if (near := self._told[view]) is not None:
            weights.tracker.add(total, weights.told, hand, near)
        return total

    def area(self, view: CloseUp, hand: Placed, rest: Rest) -> float:
        """The mask's term pixel by pixel, which the distances of outlines stand for: they see no finger that the hand
        lacks."""
        if view.alpha is None:
            return 0.0
        rig = self.space.rig
        rows = rig.pose(rest, self.space.turns(hand.angles)[None], self.space.free[:0]).rows[0][: rig.vertices]
        fine = rig.fine @ (rows @ hand.rotation.T + hand.translation)
        if fine[:, 2].min() < 0.01:
            return np.inf
        drawn = coverage(torch.from_numpy(view.places(fine)), self._edges, view.width, view.height).numpy()
        return self.weights.mask * float(np.abs(drawn - view.alpha).mean())

    def _pose(self, total: Quadratic, angles: Array) -> None:
        space, weights, size = self.space, self.weights, len(total.gradient)
        own = slice(6, 6 + len(angles))
        for off, by, weight in (
            (space.pose_whitening @ (angles - space.pose_mean), space.pose_whitening, weights.pose),
            (space.beyond(angles), np.eye(len(angles)) * (space.beyond(angles) != 0)[:, None] / LIMIT, weights.limits),
        ):
            pull = np.zeros((len(off), size))
            pull[:, own] = by
            total.add(weight * float(off @ off), np.full(len(off), 2 * weight), off, pull)

    def _key_points(self, total: Quadratic, view: CloseUp, points: Array, motion: Array) -> None:
        rows = self.space.rig.key_points[view.seen]
        off = view.places(points[rows]) - view.key_points[view.seen]
        by = view.moving(points[rows]) @ motion[rows]
        distance = np.linalg.norm(off, axis=1)
        scale = self.weights.key_points * 8.0 / max(view.width, view.height) / len(rows) * view.trust
        weight = (scale / np.maximum(distance, _POINT)).repeat(2)
        total.add(float(scale @ _huber(distance, _POINT)), weight, off.ravel(), by.reshape(-1, by.shape[-1]))

    def _mask(self, total: Quadratic, view: CloseUp, fine: Array, coarse: Array) -> None:
        assert view.outside is not None and view.slope is not None
        found = outline(view.places(fine), self._edges, view.width, view.height, 0.5)
        if not len(found.place):
            return
        off = sampled(view.outside, found.place)
        slope = np.stack([sampled(part, found.place) for part in view.slope], axis=1)
        # the point of the edge that is seen at the place
        near = np.stack([1.0 - found.share, found.share], axis=1) / fine[found.ends, 2]
        near /= near.sum(axis=1, keepdims=True)
        index = np.arange(len(off)).repeat(2)
        pick = sp.csr_array((near.ravel(), (index, found.ends.ravel())), shape=(len(off), len(fine)))
        by = self._carried(pick, coarse)
        place = view.moving(pick @ fine)
        along = np.einsum("ni,nij,njp->np", slope, place, by)
        reach = self.weights.mask_reach
        scale = self.weights.mask * found.length / (view.width * view.height)
        inside = np.abs(off) < reach
        weight = np.where(inside, scale / np.maximum(np.abs(off), _PIXEL), 0.0)
        total.add(float(scale @ _huber(np.minimum(np.abs(off), reach), _PIXEL)), weight, off, along)

    def _depth(self, total: Quadratic, view: CloseUp, fine: Array, coarse: Array) -> None:
        assert view.depth is not None
        chosen, normal, off = depth_gaps(fine, self.space.rig.faces, view.depth, view)
        if not len(chosen):
            return
        pick = sp.csr_array((np.ones(len(chosen)), (np.arange(len(chosen)), chosen)), shape=(len(chosen), len(fine)))
        by = np.einsum("ni,nip->np", normal, self._carried(pick, coarse))
        reach, scale = self.weights.depth_reach, self.weights.depth / len(chosen)
        inside = np.abs(off) < reach
        weight = np.where(inside, scale / np.maximum(np.abs(off), _METRE), 0.0)
        total.add(scale * float(_huber(np.minimum(np.abs(off), reach), _METRE).sum()), weight, off, by)

    def _carried(self, pick: sp.csr_array, coarse: Array) -> Array:
        """How picked points of the fine surface move, (n, 3, 6 + F + K)."""
        return ((pick @ self.space.rig.fine) @ coarse).reshape(pick.shape[0], 3, -1)


def moving(posed: PosedRig, hand: Placed) -> tuple[Array, Array]:
    """Rows (N, 3) of one posed hand in the camera's frame, and how they move (N, 3, 6 + F + K)."""
    turned = posed.rows[0] @ hand.rotation.T
    x, y, z = turned.T
    zero = np.zeros_like(x)
    turning = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)  # δ × x
    shifting = np.broadcast_to(np.eye(3), turning.shape)
    rest = np.concatenate([posed.by_joints[0], posed.by_shape[0]], axis=2)
    return turned + hand.translation, np.concatenate([turning, shifting, hand.rotation @ rest], axis=2)


def _huber(size: Array, soft: float) -> Array:
    """|r| where it is at least `soft`, and the parabola that touches it below."""
    return np.where(size < soft, size**2 / (2 * soft) + soft / 2, size)


def depth_gaps(fine: Array, faces: Array, depth: Array, view: CloseUp) -> tuple[Array, Array, Array]:
    """Visible vertices where depth was measured, their normals (n, 3), and how far in metres they are over what was
    measured there, along the normal."""
    normal = _normals(fine, faces)
    chosen = _visible(fine, normal, view)
    points, normal = fine[chosen], normal[chosen]
    column, row = view.places(points).astype(np.int64).T
    measured = (depth[row, column] / points[:, 2])[:, None] * points
    return chosen, normal, ((points - measured) * normal).sum(axis=1)


def _normals(vertices: Array, faces: Array) -> Array:
    """Unit normals (V, 3), faces weighted by their area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    (ux, uy, uz), (vx, vy, vz) = (b - a).T, (c - a).T
    faced = (uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx)
    corner = faces.T.ravel()
    normal = np.stack([np.bincount(corner, np.tile(part, 3), minlength=len(vertices)) for part in faced], axis=1)
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-20)


def _visible(fine: Array, normal: Array, view: CloseUp) -> Array:
    """Those of some `_SURFACE` vertices that face the camera, are hidden by no others, and where depth was measured."""
    assert view.depth is not None
    places = view.places(fine)
    facing = -(normal * fine).sum(axis=1) > 0.3 * np.linalg.norm(fine, axis=1)
    inside = np.asarray(((places >= 0) & (places < (view.width, view.height))).all(axis=1))
    pixel = np.where(inside[:, None], places, 0).astype(np.int64)
    measured = view.depth[pixel[:, 1], pixel[:, 0]] > 0
    cell = (pixel[:, 1] // 4) * (view.width // 4 + 1) + pixel[:, 0] // 4
    order = np.lexsort((fine[:, 2], cell))
    first = order[np.unique(cell[order], return_index=True)[1]]
    nearest = np.zeros(cell.max() + 1)
    nearest[cell[first]] = fine[first, 2]
    chosen = np.flatnonzero(facing & inside & measured & (fine[:, 2] < nearest[cell] + _NEAR))
    return chosen[chosen % max(1, len(fine) // _SURFACE) == 0]
