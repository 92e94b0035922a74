"""What speaks against a fit. A wrong hand that looks right is worse than none, so every doubt is told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch

from ...render.silhouette import EdgeTable, coverage
from ...scene import Array
from .picture import CloseUp
from .placed import Placed
from .problems import Problem
from .rig import Rest
from .single import FittingSettings, Single, again
from .solve import State
from .space import Space
from .starts import SKIN, distance, starts
from .terms import depth_gaps, moving
from .told import told_pose

MISSED = 0.025  # of the close-up's side: detectors miss by a fifth of it, and shuffled key points by twice as much
OVERLAP = 0.8  # intersection over union of masks: hands that fit reach 0.9
SURFACE = 0.008  # metres: the median distance to the measured surface is a quarter of it with a phone's sensor
LARGE = 1.35  # times the mean hand: adults are within 1.15
NEAREST, FARTHEST = 0.1, 5.0  # metres at which hands are photographed
UNIT = 20.0  # depth that is more often too large than any wrong focal length can tell
CLEARLY = 0.7  # of a cost: a fit that much cheaper explains pictures with depth better
FLAT = 0.5  # the same without depth, where hands that differ look alike
HARDLY = 0.9  # of a cost: a difference that noise can make
CUT, LOST = 0.02, 0.4  # shares of the hand beyond the picture's edge
ELSEWHERE = 0.03  # metres between key points and those of a told pose: trackers are within 0.01
UNEXPLAINED = 0.6  # of the hand's area: that much more mask is another hand


def unit_problem(space: Space, views: Sequence[CloseUp]) -> Problem | None:
    """Depth in another unit, or a focal length with which the hand is no hand's size; by depth, else by told poses."""
    ratios, by_depth = [], False
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
            by_depth = True
        elif (near := told_pose(space, view)) is not None:
            ratios.append(_middle(space, near) / far)
    if not ratios:
        return None
    ratio, name, focal = float(np.median(ratios)), views[0].picture.name, views[0].picture.camera.K[0, 0]
    if by_depth and (ratio > UNIT or ratio < 1 / UNIT):
        guess = "; it seems to be in millimetres, divide it by 1000" if 300 < ratio < 3000 else "; give metres"
        text = f"depth is {ratio:.3g} times the distance at which a hand looks that large{guess}"
        return Problem("depth unit", name, text)
    if not 1 / LARGE < ratio < LARGE:
        measured_by, also = (
            ("depth", "depth is along z") if by_depth else ("pose", "the pose is this camera's, in metres")
        )
        text = f"by its {measured_by} the hand is {ratio:.2g} times as large as a usual one; "
        return Problem("focal length", name, f"{text}check the focal length of {focal:.0f} pixels, and that {also}")
    return None


def _middle(space: Space, hand: Placed) -> float:
    """How far from the camera the key points of the mean hand are in a pose, metres along z."""
    rest = space.still(np.zeros(space.shape_basis.shape[1]))
    return float(_key_points(space, rest, hand)[:, 2].mean())


def _key_points(space: Space, rest: Rest, hand: Placed) -> Array:
    """A hand's key points (21, 3) in the camera's frame."""
    posed = space.rig.pose(rest, space.turns(hand.angles)[None], space.free[:0], space.rig.key_points)
    return posed.rows[0] @ hand.rotation.T + hand.translation


def shows_a_hand(space: Space, view: CloseUp, own: Single) -> bool:
    """Whether the key points of a picture are where those of the hand that was found in it are, about."""
    (hand,) = own.state.hands
    return not _no_hand(view, _missed(space, view, space.still(own.state.z), hand))


def _missed(space: Space, view: CloseUp, rest: Rest, hand: Placed) -> float:
    """The median distance in the close-up's pixels of a hand's key points from those that were seen."""
    points = _key_points(space, rest, hand)
    return float(np.median(np.linalg.norm((view.places(points) - view.key_points)[view.seen], axis=1)))


def _no_hand(view: CloseUp, missed: float) -> bool:
    return missed > MISSED * max(view.width, view.height)


def other_ways(
    space: Space,
    views: Mapping[int, CloseUp],
    ours: Mapping[int, Single],
    mirrors: Mapping[int, float],
    settings: FittingSettings,
) -> Problem | None:
    """Whether the hand of the other side, or a longer focal length, explains the pictures better; `mirrors` are what
    mirror images of some of them cost."""
    seen, pairs = views[min(views)].picture, [(views[i], ours[i]) for i in mirrors]
    side = space.rig.hand.side
    other = "left" if side == "right" else "right"
    paid, mirror = sum(own.untold for _, own in pairs), sum(mirrors.values())
    flat = all(view.depth is None for view, _ in pairs)
    if mirror < (FLAT if flat else CLEARLY) * paid:
        text = (
            f"this is a {other} hand, and the model is a {side} one: mirrored it fits at {mirror / paid:.0%} "
            "of the cost; mirror picture, camera and key points, or give a model of its side"
        )
        return Problem("other hand", seen.name, text)
    if not flat:
        return None
    long = sum(_from_afar(space, view.untold, own, settings) for view, own in pairs)
    if long < FLAT * paid:
        text = (
            "the hand's perspective is that of a longer lens: with twice the focal length of "
            f"{seen.camera.K[0, 0]:.0f} pixels it fits at {long / paid:.0%} of the cost; check K"
        )
        return Problem("focal length", seen.name, text)
    if mirror < paid / HARDLY and all(view.picture.start is None for view, _ in pairs):
        text = f"a {other} hand would fit as well; make sure that it is a {side} one, or add depth or another picture"
        return Problem("other hand", seen.name, text, fatal=False)
    return None


def distance_guessed(views: Sequence[CloseUp], hands: Sequence[Placed]) -> Problem | None:
    """That only the usual size of hands tells how far away this one is, where it does."""
    if any(view.depth is not None or view.picture.start is not None for view in views):
        return None
    far = float(np.median([hand.translation[2] for hand in hands]))
    text = (
        f"nothing tells the hand's distance but the usual size of hands, by which it is {far:.2f} m: one that is a "
        "tenth smaller is a tenth nearer; add depth or a pose"
    )
    return Problem("distance", views[0].picture.name, text, fatal=False)


def _from_afar(space: Space, view: CloseUp, own: Single, settings: FittingSettings, times: float = 2.0) -> float:
    """The cost of the same hand, that many times farther away and seen through a lens that much longer."""
    longer = replace(view, K=view.K * np.array([[times, 1, 1], [1, times, 1], [1, 1, 1]]))
    (hand,) = own.state.hands
    moved = State(own.state.z, (replace(hand, translation=times * hand.translation),))
    return again(space, longer, moved, settings).cost


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
        points, _ = moving(posed, hand)
        fine = rig.fine @ points[: rig.vertices]
        found: list[Problem] = []
        missed = _missed(self._space, view, self._rest, hand)
        share = missed / max(view.width, view.height)
        if _no_hand(view, missed):
            text = f"the key points are {share:.0%} of the hand's size away from any hand's; is one in the picture?"
            found.append(Problem("no hand", name, text))
        overlap = self._overlap(view, fine, found)
        gap = None
        if view.depth is not None:
            _, _, off = depth_gaps(fine, rig.faces, view.depth, view)
            gap = float(np.median(np.abs(off))) if len(off) else np.inf
            if gap > SURFACE:
                text = f"the hand's surface is {1e3 * gap:.0f} mm from the measured depth; the fit missed it"
                found.append(Problem("missed", name, text))
        found += self._cut(view, fine)
        if (near := told_pose(self._space, view)) is not None:
            found += self._off(view, points[rig.key_points], near)
        return missed * view.picture.camera.K[0, 0] / view.K[0, 0], overlap, gap, tuple(found)

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

    def _off(self, view: CloseUp, points: Array, near: Placed) -> list[Problem]:
        """Whether the hand is far from where the pose that the picture brings has it."""
        off = points - _key_points(self._space, self._rest, near)
        away = float(np.linalg.norm(off, axis=1).mean())
        if away < ELSEWHERE:
            return []
        text = f"the hand is {1e3 * away:.0f} mm from where the given pose has it; check the pose and its camera"
        return [Problem("pose", view.picture.name, text, fatal=False)]

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
