"""Additivity and homogeneity, against avatars whose deviation is known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from handbench.errors import Unsupported
from handbench.method import Avatar, PosedAvatar
from handbench.results.laws import deviation, deviations, drawing, measured_laws, pairs_of
from handbench.scene import (
    Array,
    Camera,
    Directional,
    Environment,
    Frame,
    Light,
    Mesh,
    Pose,
    Prediction,
    Topology,
    Viewpoint,
    leaves,
)

CAMERA = Camera("front", 2, 2, [[2, 0, 1], [0, 2, 1], [0, 0, 1]], np.eye(3, 4))
MESH = Mesh(np.eye(3), Topology([[0, 1, 2]], [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]]))


def _directional(power: float) -> Directional:
    return Directional([0, 0, 1], [power] * 3)


def _frame(lighting: str, kind: str, light: Light) -> Frame:
    return Frame("s01", "fist", lighting, Pose(np.zeros((1, 3))), MESH, CAMERA, light, "held-out", kind)


FRAMES = [
    *(_frame(f"group-{i}", "group", _directional(0.5 + i)) for i in range(4)),
    *(_frame(f"env-{i}", "environment", Environment(f"env-{i}", np.full((1, 2, 3), 1.0 + i))) for i in range(3)),
    _frame("full", "full", _directional(2.0)),
]


def _power(light: Light) -> float:
    single = (leaf.radiance if isinstance(leaf, Environment) else leaf.irradiance for leaf in leaves(light))
    return sum(float(np.mean(value)) for value in single)


class Shaded(Avatar):
    """Answers `response(power)` in every pixel and counts how often it is asked."""

    def __init__(self, response: Callable[[float], float | Array]) -> None:
        self.response = response
        self.asked: list[tuple[Viewpoint, Light]] = []

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        return PosedShaded(self, viewpoint)

    def draw(self, viewpoint: Viewpoint, light: Light) -> Prediction:
        self.asked.append((viewpoint, light))
        return Prediction(np.ones((2, 2, 3)) * self.response(_power(light)), np.ones((2, 2)))


class PosedShaded(PosedAvatar):
    def __init__(self, avatar: Shaded, viewpoint: Viewpoint) -> None:
        self.avatar, self.viewpoint = avatar, viewpoint

    def relight(self, light: Light) -> Prediction:
        return self.avatar.draw(self.viewpoint, light)


def test_deviations_of_a_square_are_those_worked_out_by_hand() -> None:
    # powers 1 and 2 under 0.5 and 3: p² gives 0.25 + 36 and 0.5·1 + 3·4 where the answer is 6.5² = 42.25
    draw = drawing(Shaded(lambda p: p**2), FRAMES[0].query)
    found = deviations(draw, _directional(1.0), _directional(2.0), (0.5, 3.0))
    assert found.additivity == pytest.approx((42.25 - 36.25) / 42.25)
    assert found.homogeneity == pytest.approx((36 - 12) / 36)
    assert found.linearity == pytest.approx((42.25 - 12.5) / 42.25)
    turned = deviations(draw, _directional(1.0), _directional(2.0), (3.0, 0.5))
    assert turned.homogeneity == pytest.approx((9 - 3) / 9), "the worse of the two lights, whichever it is"


def test_each_law_can_break_alone() -> None:
    def exposed(p: float) -> float:  # homogeneous, but two lights at once are dimmed: no function of power alone
        return p

    class Dimmed(Shaded):
        def draw(self, viewpoint: Viewpoint, light: Light) -> Prediction:
            answer = super().draw(viewpoint, light)
            several = len(list(leaves(light))) > 1
            return Prediction(answer.image * (0.9 if several else 1.0), answer.alpha)

    dimmed = measured_laws(Dimmed(exposed), FRAMES, FRAMES[0].query)
    assert dimmed.homogeneity < 1e-6 and dimmed.additivity == pytest.approx(0.1, rel=1e-3)
    biased = measured_laws(Shaded(lambda p: p + 1.0), FRAMES, FRAMES[0].query)
    assert biased.homogeneity > 0.01 and biased.additivity > 0.01


def test_a_linear_avatar_is_asked_thirteen_times_in_one_pose_and_camera() -> None:
    avatar = Shaded(lambda p: 0.3 * p)
    found = measured_laws(avatar, FRAMES, FRAMES[2].query)
    assert found.pairs == 3 and found.reason is None
    assert max(found.additivity, found.homogeneity, found.linearity) < 1e-6
    assert len(avatar.asked) == 13
    assert len({id(viewpoint) for viewpoint, _ in avatar.asked}) == 1, "posed once"


def test_the_lights_are_of_every_kind_and_the_choice_repeats() -> None:
    kinds = {id(frame.light): frame.kind for frame in FRAMES}
    for seed in range(5):
        pairs = pairs_of(FRAMES, seed)
        chosen = [{kinds[id(one)], kinds[id(other)]} for one, other in pairs]
        assert pairs == pairs_of(FRAMES[::-1], seed)
        assert set().union(*chosen) == {"group", "environment", "full"}
        assert {"environment"} in chosen and all(len(pair) == 1 for pair in chosen if "environment" in pair)
    assert len({str(pairs_of(FRAMES, seed)) for seed in range(5)}) > 1


def test_few_lights_make_fewer_pairs() -> None:
    assert [len(pairs_of(FRAMES[:n], 0)) for n in (1, 2, 3, 4, 5, 6)] == [1, 1, 2, 2, 3, 3]


def test_what_a_method_cannot_draw_is_left_out_and_told() -> None:
    class Picky(Shaded):
        def draw(self, viewpoint: Viewpoint, light: Light) -> Prediction:
            if any(isinstance(single, Environment) for single in leaves(light)):
                raise Unsupported("no environments")
            return super().draw(viewpoint, light)

    found = measured_laws(Picky(lambda p: p), FRAMES, FRAMES[0].query)
    assert found.pairs == 2 and found.reason == "Unsupported: no environments"
    nothing = measured_laws(Picky(lambda p: 1 / 0), FRAMES, FRAMES[0].query)
    assert (nothing.pairs, nothing.linearity) == (0, None)


def test_pictures_that_are_not_finite_leave_no_number() -> None:
    found = measured_laws(Shaded(lambda p: np.nan if p > 2 else p), FRAMES[:4], FRAMES[0].query)
    assert found.linearity is None and found.reason.startswith("non-finite")


def test_deviation_is_relative_to_the_brightest_pixel() -> None:
    one = np.array([[1.0, 4.0]])
    assert deviation(one, one) == 0.0
    assert deviation(one, np.array([[1.0, 5.0]])) == pytest.approx(0.2)
    assert deviation(one, np.array([[np.nan, 4.0]])) == float("inf")
    assert deviation(np.zeros((1, 2)), np.zeros((1, 2))) == 0.0
