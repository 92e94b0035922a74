"""What speaks against a fit. A wrong hand that looks right is worse than none, so every doubt is told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ...render.silhouette import EdgeTable, coverage
from ...scene import Array
from .picture import CloseUp
from .problems import Problem
from .single import Settings, Single, single
from .solve import State, cost, solve
from .space import Space
from .starts import SKIN, distance, starts
from .terms import Objective, Placed, gaps, in_camera

MISSED = 0.025  # of the close-up's side: detectors miss by a fifth of it, and shuffled key points by twice as much
OVERLAP = 0.8  # intersection over union of masks: hands that fit reach 0.9
SURFACE = 0.008  # metres: the median distance to the measured surface is a quarter of it with a phone's sensor
LARGE = 1.35  # times the mean hand: adults are within 1.15
NEAREST, FARTHEST = 0.1, 5.0  # metres at which hands are photographed
UNIT = 20.0  # depth that is more often too large than any wrong focal length can tell
CLEARLY = 0.7  # of a cost: a fit that much cheaper explains the picture better
HARDLY = 0.9  # of a cost: a difference that noise can make
CUT, LOST = 0.02, 0.4  # shares of the hand beyond the picture's edge
UNEXPLAINED = 0.6  # of the hand's area: that much more mask is another hand


def unit_problem(space: Space, views: Sequence[CloseUp]) -> Problem | None:
    """Depth in another unit, or a focal length with which the hand is no hand's size."""
    ratios = []
    for view in views:
        found = starts(space, replace(view, depth=None), 1)
        if found and _no_hand(view, found[0].missed):
            continue
        far = float(found[0].points[view.seen, 2].mean()) if found else 0.0  # it would touch the camera
        if not NEAREST < far < FARTHEST:
            return Problem(
                "focal length",
                view.picture.name,
                f"a hand of the usual size would be {far:.2g} m away with a focal length of "
                f"{view.picture.camera.K[0, 0]:.0f} pixels; check K",
            )
        if (measured := distance(view)) is not None:
            ratios.append((measured + SKIN) / far)
    if not ratios:
        return None
    ratio = float(np.median(ratios))
    if ratio > UNIT or ratio < 1 / UNIT:
        guess = "; it seems to be in millimetres, divide it by 1000" if 300 < ratio < 3000 else "; give metres"
        text = f"depth is {ratio:.3g} times the distance at which a hand looks that large{guess}"
        return Problem("depth unit", views[0].picture.name, text)
    if not 1 / LARGE < ratio < LARGE:
        camera = views[0].picture.camera
        return Problem(
            "focal length",
            views[0].picture.name,
            f"by its depth the hand is {ratio:.2g} times as large as a usual one; "
            f"check the focal length of {camera.K[0, 0]:.0f} pixels, and that depth is along z",
        )
    return None


def _no_hand(view: CloseUp, missed: float) -> bool:
    return missed > MISSED * max(view.width, view.height)


def other_ways(
    space: Space, views: Sequence[CloseUp], ours: Sequence[Single], settings: Settings, most: int = 3
) -> Problem | None:
    """Whether the hand of the other side, or a longer focal length, explains the pictures better; `most` are tried."""
    tried = np.unique(np.linspace(0, len(views) - 1, most).round().astype(int))
    pairs = [(views[i], ours[i]) for i in tried]
    name, side = views[0].picture.name, space.rig.hand.side
    other = "left" if side == "right" else "right"
    paid = sum(own.cost for _, own in pairs)
    mirror = sum(_cost(space, view.mirrored(), settings) for view, _ in pairs)
    if mirror < CLEARLY * paid:
        text = (
            f"this is a {other} hand, and the model is a {side} one: mirrored it fits at {mirror / paid:.0%} "
            "of the cost; mirror picture, camera and key points, or give a model of its side"
        )
        return Problem("other hand", name, text)
    if all(view.depth is None for view, _ in pairs):
        long = sum(_from_afar(space, view, own, settings) for view, own in pairs)
        if long < CLEARLY * paid:
            focal = views[0].picture.camera.K[0, 0]
            text = (
                f"the hand's perspective is that of a longer lens: with twice the focal length of {focal:.0f} pixels "
                f"it fits at {long / paid:.0%} of the cost; check K"
            )
            return Problem("focal length", name, text)
    if mirror < paid / HARDLY:
        text = f"a {other} hand would fit as well; make sure that it is a {side} one, or add depth or another picture"
        return Problem("other hand", name, text, fatal=False)
    return None


def _cost(space: Space, view: CloseUp, settings: Settings) -> float:
    found = single(space, view, settings)
    return np.inf if found is None else found.cost


def _from_afar(space: Space, view: CloseUp, own: Single, settings: Settings, times: float = 2.0) -> float:
    """The cost of the same hand, that many times farther away and seen through a lens that much longer."""
    longer = replace(view, K=view.K * np.array([[times, 1, 1], [1, times, 1], [1, 1, 1]]))
    (hand,) = own.state.hands
    objective = Objective(space, [longer], settings.weights)
    moved = State(own.state.z, (replace(hand, translation=times * hand.translation),))
    return cost(objective, solve(objective, moved, settings.steps))


class Judge:
    """Measures fitted hands of one shape against their pictures."""

    def __init__(self, space: Space, z: Array) -> None:
        self._space, self._edges = space, EdgeTable(space.rig.faces)
        self._rest = space.still(z)

    def of(self, view: CloseUp, hand: Placed) -> tuple[float, float | None, float | None, tuple[Problem, ...]]:
        """Median distance of the key points in the picture's pixels, overlap of the masks, median distance to the
        measured surface in metres, and what is wrong."""
        rig, name = self._space.rig, view.picture.name
        posed = rig.pose(self._rest, self._space.turns(hand.angles)[None], self._space.free[:0])
        points, _ = in_camera(posed, hand)
        fine = rig.fine @ points[: rig.vertices]
        found: list[Problem] = []
        missed = np.median(np.linalg.norm((view.places(points[rig.key_points]) - view.key_points)[view.seen], axis=1))
        share = missed / max(view.width, view.height)
        if _no_hand(view, float(missed)):
            text = f"the key points are {share:.0%} of the hand's size away from any hand's; is one in the picture?"
            found.append(Problem("no hand", name, text))
        overlap = self._overlap(view, fine, found)
        gap = None
        if view.depth is not None:
            _, _, off = gaps(fine, rig.faces, view.depth, view)
            gap = float(np.median(np.abs(off))) if len(off) else np.inf
            if gap > SURFACE:
                text = f"the hand's surface is {1e3 * gap:.0f} mm from the measured depth; the fit missed it"
                found.append(Problem("missed", name, text))
        found += self._cut(view, fine)
        return float(missed) * view.picture.camera.K[0, 0] / view.K[0, 0], overlap, gap, tuple(found)

    def _overlap(self, view: CloseUp, fine: Array, found: list[Problem]) -> float | None:
        if view.alpha is None:
            return None
        places = torch.from_numpy(view.places(fine))
        drawn, given = coverage(places, self._edges, view.width, view.height).numpy(), view.alpha
        shared = np.minimum(drawn, given).sum()
        union = np.maximum(drawn, given).sum()
        extra = (given.sum() - shared) / max(drawn.sum(), 1.0)
        if extra > UNEXPLAINED:
            text = f"the mask has {extra:.0%} more than the hand that the key points show; give the mask of one hand"
            found.append(Problem("two hands", view.picture.name, text))
        elif shared < OVERLAP * union:
            text = (
                f"hand and mask overlap by {shared / union:.0%} only; the fit missed it, or the mask is another thing's"
            )
            found.append(Problem("missed", view.picture.name, text))
        return float(shared / union)

    def _cut(self, view: CloseUp, fine: Array) -> list[Problem]:
        """How much of the hand, without the forearm, is beyond the picture's edge."""
        rig, camera = self._space.rig, view.picture.camera
        own = rig.hand.weights(rig.level)[:, np.flatnonzero(rig.below[rig.hand.wrist])].sum(axis=1) > 0.5
        pixels = fine[own] @ camera.K.T
        places = pixels[:, :2] / pixels[:, 2:]
        beyond = float(np.mean(((places < 0) | (places > (camera.width, camera.height))).any(axis=1)))
        if beyond < CUT:
            return []
        text = f"{beyond:.0%} of the hand is beyond the edge of the picture, and what is there is a guess"
        return [Problem("cut", view.picture.name, text, fatal=beyond > LOST)]
