"""Kept shadows: the same as fresh ones, and never those of another light."""

from __future__ import annotations

import numpy as np
import pytest

from handbench.hand import OpenHand, named_pose
from handbench.light.lightset import LightSet, light_samples
from handbench.render.posed import PosedSurface
from handbench.render.visibility import visibility
from handbench.scene import Directional, Group, Mesh, Point


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    hand = OpenHand.load()
    return hand.mesh(hand.neutral(), named_pose("fist"), 1)


def _fresh(mesh: Mesh, posed: PosedSurface, lights: LightSet) -> np.ndarray:
    return visibility(mesh, posed.atlas, lights.directions, lights.positions)


def test_kept_shadows_are_the_fresh_ones_in_any_order(mesh: Mesh) -> None:
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(5, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    posed = PosedSurface(mesh, 64)
    for order in ([0, 1, 2], [4, 2, 0, 3], [1]):
        lights = light_samples(Group(tuple(Directional(directions[i], np.ones(3)) for i in order)))
        assert np.array_equal(posed.visibility(lights).numpy(), _fresh(mesh, posed, lights))


def test_a_near_light_is_not_taken_for_a_distant_one(mesh: Mesh) -> None:
    posed = PosedSurface(mesh, 64)
    distant, near = (light_samples(light) for light in (Directional([0, 0, 1], [1] * 3), Point([0, 0, 1], [1] * 3)))
    posed.visibility(distant)
    assert np.array_equal(posed.visibility(near).numpy(), _fresh(mesh, posed, near))


def test_darkness_has_no_rows(mesh: Mesh) -> None:
    assert PosedSurface(mesh, 64).visibility(light_samples(Group(()))).shape[0] == 0
