"""Fingers are alike bone by bone, side by side; a finger that nobody saw is completed from its neighbour."""

from __future__ import annotations

import numpy as np
import pytest

from handbench.hand import hand_model
from handbench.hand.openhand import OpenHand
from handbench.hand.twins import completed, twins
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.surface import mesh_normals

LEVEL = 1


@pytest.fixture(scope="module")
def atlas() -> Atlas:
    return Atlas.of(hand_model().topology(LEVEL), 96)


@pytest.fixture(scope="module")
def bones(atlas: Atlas) -> np.ndarray:
    """The name of the bone that owns each texel."""
    names = np.array(hand_model().joint_names)
    return names[atlas.interpolate(hand_model().weights(LEVEL)).argmax(axis=1)]


def test_twins_are_the_same_bone_and_the_same_side_of_another_finger(atlas: Atlas, bones: np.ndarray) -> None:
    hand = hand_model()
    position, weights = atlas.interpolate(hand.rest_position(LEVEL)), atlas.interpolate(hand.weights(LEVEL))
    mesh = hand.mesh(hand.neutral(), hand.named_pose("rest"), LEVEL)
    facing = atlas.interpolate(mesh_normals(mesh))
    found = twins(hand, position, weights)
    assert len(found) == 6
    for step, twin in zip((1, -1, 2, -2, 3, -3), found, strict=True):
        has = np.flatnonzero(twin >= 0)
        order = ["index", "middle", "ring", "little"]
        fingers = [np.array([order.index(name[:-1]) for name in bones[some]]) for some in (twin[has], has)]
        assert len(has) and (fingers[0] - fingers[1] == step).all()
        assert (np.array([name[-1] for name in bones[twin[has]]]) == [name[-1] for name in bones[has]]).all()
        assert np.median((facing[has] * facing[twin[has]]).sum(axis=1)) > 0.85  # index and little face apart
    on_fingers = np.isin(bones, [f"{finger}{k}" for finger in ("index", "middle", "ring", "little") for k in (1, 2, 3)])
    assert (found[0] >= 0)[~on_fingers].sum() == 0
    assert np.mean(((found[0] >= 0) | (found[1] >= 0))[on_fingers]) > 0.95


def test_a_hidden_finger_gets_a_nail_from_its_neighbour(atlas: Atlas, bones: np.ndarray) -> None:
    hand = OpenHand.load()
    nail = atlas.interpolate(hand.vertex_map("nail", LEVEL)[:, None])[:, 0] > 0.5
    colour = np.where(nail, 0.8, 0.4) * np.array([[1.0], [0.8], [0.7]])
    hidden = np.isin(bones, ["ring2", "ring3"])
    found = completed(hand, LEVEL, atlas, np.where(hidden, 0.0, colour), ~hidden)
    assert (found.source[~hidden] == 0).all()
    assert np.mean(found.source[hidden] == found.names.index("finger")) > 0.9
    drawn = found.colour[0, hidden] > 0.6
    overlap = (drawn & nail[hidden]).sum() / (drawn | nail[hidden]).sum()
    assert overlap > 0.5
    np.testing.assert_allclose(np.median(found.colour[:, hidden & ~nail], axis=1), [0.4, 0.32, 0.28], rtol=0.1)


def test_a_prior_fills_what_no_finger_knows(atlas: Atlas, bones: np.ndarray) -> None:
    hidden = bones == "wrist"
    prior = np.full((3, atlas.count), 0.3)
    found = completed(hand_model(), LEVEL, atlas, np.where(hidden, 0.0, 0.5) * np.ones((3, 1)), ~hidden, prior)
    assert (found.source[hidden] == found.names.index("prior")).all()
    np.testing.assert_allclose(found.colour, 0.5, rtol=0.02)
