"""Where a fit begins: hands whose key points are seen where they were found, from every side.

From one picture a palm and a back, or a finger bent towards the camera and away from it, look alike to key points. So
many hands are turned to look like them, the best different ones are kept, and mask and depth decide later.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...scene import Array
from .picture import CloseUp
from .placed import Placed
from .rig import Rest, rodrigues
from .space import LIMIT, Space

SIDES = 14  # from which the hand may be seen
STEPS = 25
_PIXELS = 1.5  # what key points miss, about
_SIZE = 0.25  # standard deviation of the logarithm of a hand's size, where depth tells it
SKIN = 0.008  # metres from a joint to the skin over it
_SETTLED = 1e-3  # of a cost: steps that gain less are the last, for all hands that may be kept
_APART = 0.02  # metres by which key points of different starts differ


@dataclass(frozen=True)
class Start:
    """A hand to begin with; `size` of the mean hand's, `cost` in squared standard deviations, `missed` in pixels: the
    median distance of the key points."""

    hand: Placed
    size: float
    cost: float
    missed: float
    points: Array


@dataclass(frozen=True)
class _Many:
    """Hands in a batch: angles (B, F), rotation (B, 3, 3), translation (B, 3), size (B,) as its logarithm."""

    angles: Array
    rotation: Array
    translation: Array
    size: Array

    def moved(self, step: Array) -> _Many:
        return _Many(
            self.angles + step[:, 7:],
            rodrigues(step[:, :3])[0] @ self.rotation,
            self.translation + step[:, 3:6],
            self.size + step[:, 6],
        )

    def where(self, better: Array, other: _Many) -> _Many:
        parts = zip(vars(self).values(), vars(other).values(), strict=True)
        return _Many(*(_choose(better, a, b) for a, b in parts))


class _Model(NamedTuple):
    """Cost (B,), its gradient (B, 7 + F) and Hessian, and the key points (B, 21, 3) in the camera's frame."""

    cost: Array
    gradient: Array
    hessian: Array
    points: Array


def starts(space: Space, view: CloseUp, count: int, also: tuple[Placed, ...] = ()) -> list[Start]:
    """The best `count` different hands that look like a picture's key points, best first; `also` are tried too."""
    rest = space.still(np.zeros(space.shape_basis.shape[1]))
    far = distance(view)
    many = _from_sides(space, view, rest, far, also)
    model = _model(space, view, rest, far, many)
    damping = np.full(len(many.size), 1e-2)
    for _ in range(STEPS):
        step = _steps(model, damping)
        tried = many.moved(step)
        found = _model(space, view, rest, far, tried)
        better = found.cost < model.cost
        settled = ~(found.cost < (1 - _SETTLED) * model.cost) & (damping < 1.0)
        many = tried.where(better, many)
        model = _Model(*(_choose(better, *parts) for parts in zip(found, model, strict=True)))
        damping = np.where(better, damping / 3, damping * 5).clip(1e-6, 1e6)
        if settled[model.cost < 1.5 * model.cost.min()].all():
            break
    return _different(view, many, model, count)


def distance(view: CloseUp) -> float | None:
    """The middle depth of the hand, if it was measured."""
    if view.depth is None:
        return None
    column, row = view.key_points[view.seen].astype(int).T
    near = [view.depth[max(r - 2, 0) : r + 3, max(c - 2, 0) : c + 3] for r, c in zip(row, column, strict=True)]
    values = np.concatenate([patch[patch > 0] for patch in near])
    return float(np.median(values)) if len(values) else None


def _from_sides(space: Space, view: CloseUp, rest: Rest, measured: float | None, also: tuple[Placed, ...]) -> _Many:
    """The mean pose seen from `SIDES` directions, turned in the picture, moved and scaled as key points lie."""
    turns = space.turns(space.pose_mean[None])
    rows = space.rig.pose(rest, turns, space.free[:0], space.rig.key_points[view.seen]).rows[0]
    middle = rows.mean(axis=0)
    found = np.linalg.solve(view.K, np.c_[view.key_points[view.seen], np.ones(len(rows))].T).T[:, :2]
    aim = np.median(found, axis=0)
    rotation, translation = [], []
    for side in _sphere(SIDES):
        facing = _towards(side)  # takes the side to the camera's -z
        flat = (rows - middle) @ facing.T[:, :2]
        seen = (found - aim)[:, 0] + 1j * (found - aim)[:, 1]
        ours = flat[:, 0] + 1j * flat[:, 1]
        fitted = (np.conj(ours) @ seen) / max(float((np.abs(ours) ** 2).sum()), 1e-12)
        angle, scale = np.angle(fitted), max(float(np.abs(seen).mean() / np.abs(ours).mean()), 1e-3)
        turn = rodrigues(np.array([0.0, 0.0, angle]))[0] @ facing
        far = measured + SKIN if measured is not None else 1.0 / scale
        rotation.append(turn)
        translation.append(far * np.array([*aim, 1.0]) - turn @ middle)
    angles = [space.pose_mean] * SIDES + [hand.angles for hand in also]
    rotation += [hand.rotation for hand in also]
    translation += [hand.translation for hand in also]
    return _Many(np.array(angles), np.array(rotation), np.array(translation), np.zeros(len(angles)))


def _model(space: Space, view: CloseUp, rest: Rest, measured: float | None, many: _Many) -> _Model:
    """How far hands are from looking like the key points, and from natural ones."""
    posed = space.rig.pose(rest, space.turns(many.angles), space.free, space.rig.key_points)
    size = np.exp(many.size)[:, None, None]
    turned = size * posed.rows @ np.swapaxes(many.rotation, 1, 2)
    points = turned + many.translation[:, None]
    ahead = np.maximum(points[..., 2:], 1e-2)
    safe = np.concatenate([points[..., :2], ahead], axis=-1)
    x, y, z = np.moveaxis(turned, -1, 0)
    zero = np.zeros_like(x)
    turning = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=-1).reshape(*turned.shape, 3)
    shifting = np.broadcast_to(np.eye(3), turning.shape)
    bending = many.rotation[:, None] @ posed.by_joints * size[..., None]
    by = np.concatenate([turning, shifting, turned[..., None], bending], axis=-1)
    pixel = max(view.width, view.height) / 192.0 * _PIXELS
    off = (view.places(safe) - view.key_points)[:, view.seen] / pixel
    by_place = (view.moving(safe) @ by)[:, view.seen] / pixel
    far = np.linalg.norm(off, axis=-1)
    weight = (view.trust / np.maximum(far, 1.0)).repeat(2, axis=1)
    cost = 2 * np.where(far < 1.0, far**2 / 2 + 0.5, far) @ view.trust
    off, by_place = off.reshape(len(off), -1), by_place.reshape(len(off), -1, by.shape[-1])
    gradient = np.einsum("bn,bn,bnp->bp", weight, off, by_place)
    hessian = np.swapaxes(by_place, 1, 2) @ (weight[..., None] * by_place)
    # priors: natural poses; the mean size, or the measured distance
    strange = (many.angles - space.pose_mean) @ space.pose_whitening.T
    cost = cost + (strange**2).sum(axis=1)
    gradient[:, 7:] += strange @ space.pose_whitening
    hessian[:, 7:, 7:] += space.pose_whitening.T @ space.pose_whitening
    beyond = space.beyond(many.angles)
    cost = cost + (beyond**2).sum(axis=1)
    gradient[:, 7:] += beyond / LIMIT
    index = np.arange(7, gradient.shape[1])
    hessian[:, index, index] += (beyond != 0) / LIMIT**2
    if measured is None:
        hessian[:, 6, 6] += 1e8
    else:
        cost = cost + (many.size / _SIZE) ** 2
        gradient[:, 6] += many.size / _SIZE**2
        hessian[:, 6, 6] += 1 / _SIZE**2
        behind = (np.median(points[:, view.seen, 2], axis=1) - measured - SKIN) / 0.01
        cost = cost + behind**2
        by_depth = by[:, view.seen, 2].mean(axis=1) / 0.01
        gradient += behind[:, None] * by_depth
        hessian += by_depth[:, :, None] * by_depth[:, None]
    cost = np.where((points[..., 2] <= 1e-2).any(axis=1), np.inf, cost)
    return _Model(cost, gradient, hessian, points)


def _steps(model: _Model, damping: Array) -> Array:
    """Damped steps (B, 7 + F)."""
    hessian, index = model.hessian.copy(), np.arange(model.gradient.shape[1])
    hessian[:, index, index] *= 1 + damping[:, None]
    hessian[:, index, index] += 1e-6
    return np.linalg.solve(hessian, -model.gradient[..., None])[..., 0]


def _different(view: CloseUp, many: _Many, model: _Model, count: int) -> list[Start]:
    """The cheapest hands of which no two are alike."""
    cost, points = model.cost, model.points
    kept: list[Start] = []
    for b in np.argsort(cost):
        if len(kept) == count or not np.isfinite(cost[b]):
            break
        shape = points[b] - points[b].mean(axis=0)
        if all(np.abs(shape - (k.points - k.points.mean(axis=0))).max() > _APART for k in kept):
            off = np.linalg.norm(view.places(points[b]) - view.key_points, axis=1)[view.seen]
            hand = Placed(many.angles[b], many.rotation[b], many.translation[b])
            kept.append(Start(hand, float(np.exp(many.size[b])), float(cost[b]), float(np.median(off)), points[b]))
    return kept


def _sphere(count: int) -> Array:
    """Unit vectors (count, 3) spread evenly."""
    index = np.arange(count) + 0.5
    polar, around = np.arccos(1 - 2 * index / count), np.pi * (1 + 5**0.5) * index
    return np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], axis=1)


def _towards(side: Array) -> Array:
    """A rotation (3, 3) that takes a unit vector to -z."""
    up = np.eye(3)[np.abs(side).argmin()]
    x = np.cross(up, side)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(-side, x), -side])


def _choose(first: Array, one: Array, other: Array) -> Array:
    """Of two batches the first one's items where `first` (B,) is true."""
    return np.where(first.reshape(-1, *[1] * (one.ndim - 1)), one, other)
