"""Joints and vertices: closed forms, and what does not correspond."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from handbench.errors import InputError
from handbench.metrics import Pair, metric
from handbench.metrics.geometry.points import point_error
from handbench.scene import Array, Mesh, Topology

PICTURE, MASK = np.zeros((1, 1, 3)), np.ones((1, 1))
RNG = np.random.default_rng(0)
POINTS = RNG.normal(0.0, 0.05, (21, 3))
FACES = np.arange(21).reshape(7, 3)


def pair(found: Array | None, true: Array | None) -> Pair:
    return Pair(PICTURE, PICTURE, MASK, prediction_joints=found, truth_joints=true)


def meshes(found: Mesh | None, true: Mesh | None) -> Pair:
    return Pair(PICTURE, PICTURE, MASK, prediction_mesh=found, truth_mesh=true)


def mesh(points: Array, faces: Array = FACES) -> Mesh:
    return Mesh(points, Topology(faces, np.zeros((1, 2)), 0 * faces))


def test_both_are_the_mean_distance_in_millimetres() -> None:
    moved = POINTS + RNG.normal(0.0, 0.004, POINTS.shape)
    expected = 1e3 * np.diag(cdist(moved, POINTS)).mean()
    assert metric("joint")([pair(moved, POINTS)])[0].value == pytest.approx(expected)
    assert metric("vertex")([meshes(mesh(moved), mesh(POINTS))])[0].value == pytest.approx(expected)
    assert point_error(POINTS + np.array([0.003, 0.0, 0.004]), POINTS) == pytest.approx(5.0)


@pytest.mark.parametrize("spec", ["joint", "vertex"])
def test_the_truth_is_exactly_perfect_and_nothing_is_aligned(spec: str) -> None:
    def score(points: Array) -> float | None:
        return metric(spec)([pair(points, POINTS) if spec == "joint" else meshes(mesh(points), mesh(POINTS))])[0].value

    assert score(POINTS.copy()) == metric(spec).perfect == 0.0
    assert score(POINTS + np.array([0.0, 0.01, 0.0])) == pytest.approx(10.0)
    assert score(2.0 * POINTS) == pytest.approx(1e3 * np.linalg.norm(POINTS, axis=1).mean())
    assert "align:none" in metric(spec).signature.split("|")


def test_what_does_not_correspond_has_a_reason() -> None:
    joint, vertex = metric("joint"), metric("vertex")
    assert joint([pair(POINTS[:16], POINTS)])[0].reason == "other joints: the prediction has 16, the truth 21"
    assert joint([pair(None, POINTS)])[0].reason == "the method gives no joints"
    assert joint([pair(POINTS, None)])[0].reason == "the capture gives no joints"
    broken = POINTS.copy()
    broken[3, 1] = np.inf
    assert joint([pair(broken, POINTS)])[0].reason == "non-finite joints: 1 value"
    more = mesh(np.concatenate([POINTS, POINTS]))
    assert "42 vertices do not correspond to the truth's 21" in vertex([meshes(more, mesh(POINTS))])[0].reason
    turned = mesh(POINTS, FACES[:, ::-1])
    assert vertex([meshes(turned, mesh(POINTS))])[0].reason.startswith("another topology")
    assert vertex([meshes(None, mesh(POINTS))])[0].reason == "the method gives no mesh"
    for found, true in ((POINTS[:2], POINTS), (POINTS[:0], POINTS[:0])):
        with pytest.raises(InputError, match="do not correspond"):
            point_error(found, true)


def test_millimetres_are_named() -> None:
    """Lengths are metres: what is a thousand times the truth, or a thousandth, is no answer; twice as large is."""
    theirs = 1e3 * POINTS
    for spec, of in (("joint", lambda a, b: pair(a, b)), ("vertex", lambda a, b: meshes(mesh(a), mesh(b)))):
        for found, true, whose in ((theirs, POINTS, "prediction"), (POINTS, theirs, "truth")):
            (score,) = metric(spec)([of(found, true)])
            assert score.value is None and f"the {whose} seems to be in millimetres; give metres" in score.reason
        assert metric(spec)([of(100 * POINTS, POINTS)])[0].value > 0
        assert metric(spec)([of(0 * POINTS, POINTS)])[0].value > 0
