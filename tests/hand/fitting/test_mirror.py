"""What a mirror image finds is a start for the picture, and pictures of a sequence help each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.fitting import scan, sitter
from benchmarks.fitting_captures import GIVEN, found_in, known
from handbench.hand import hand_model
from handbench.hand.fitting import QUICK, fit
from handbench.hand.fitting.mirror import turned
from handbench.hand.fitting.picture import CloseUp
from handbench.hand.fitting.placed import Placed, in_camera
from handbench.hand.fitting.sequence import between
from handbench.hand.fitting.space import Space


def test_a_turned_hand_looks_as_it_did_in_the_mirror() -> None:
    someone = sitter(np.random.default_rng(11))
    space, view = Space.of(someone.hand, 1), CloseUp.of(someone.picture(np.random.default_rng(0), depth=False))
    rest = space.still(np.zeros(space.shape_basis.shape[1]))
    someones = in_camera(space, someone.pose, someone.camera)
    hand = replace(someones, translation=someones.translation * [-1.0, 1.0, 1.0])  # somewhere in the mirror

    def places(seen: CloseUp, placed: Placed) -> np.ndarray:
        rows = space.rig.pose(rest, space.turns(placed.angles)[None], space.free[:0], space.rig.key_points).rows[0]
        return seen.places(rows @ placed.rotation.T + placed.translation)

    mirror = places(view.mirrored(), hand)
    mirror[:, 0] = view.width - mirror[:, 0]
    off, unturned = (np.linalg.norm(mirror - places(view, one), axis=1).mean() for one in (turned(hand), someones))
    assert off < 0.15 * np.ptp(mirror, axis=0).max()  # what perspective makes of a hand's depth
    assert off < 0.5 * unturned


def test_a_hand_from_its_edge_is_no_left_hand() -> None:
    one = known("openwild", "mini")[0][0]
    assert one.groups[1] == "from the edge"
    found = fit(hand_model(), [GIVEN["key points, mask"](one.picture)])
    assert found.converged, found.reason
    assert found_in(hand_model(), one.truth, found).scaled < 0.010


def test_a_hand_that_was_missed_between_others_is_found_from_theirs() -> None:
    space = Space.of(hand_model(), 1)
    three = [replace(one, shape=space.shape_mean) for one in scan(np.random.default_rng([1, 8]), 60)[:3]]
    views = {i: CloseUp.of(one.picture(np.random.default_rng(i), True)) for i, one in enumerate(three)}
    z = np.zeros(space.shape_basis.shape[1])
    hands = {i: in_camera(space, one.pose, one.camera) for i, one in enumerate(three)}
    bent = replace(hands[1], angles=np.where(np.arange(len(space.free)) % 7 == 0, space.most, hands[1].angles))
    found = between(space, views, hands | {1: bent}, z, QUICK, lambda done: None)
    rest = space.still(z)

    def off(hand: Placed) -> float:
        own, true = (space.rig.pose(rest, space.turns(one.angles)[None], space.free[:0]) for one in (hand, hands[1]))
        return float(np.linalg.norm(own.rows[0] - true.rows[0], axis=1).mean())

    before, after = off(bent), off(found[1])
    assert after < 0.005 < 0.5 * before
    assert found[0] is hands[0] and found[2] is hands[2]
