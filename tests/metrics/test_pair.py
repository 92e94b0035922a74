"""What a pair refuses, and metrics that look at a pair rather than at its pictures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from handbench.errors import InputError, Unsupported
from handbench.metrics import Metric, Pair, PairFamily, metric, scores
from handbench.scene import Mesh, Topology

SIZE = (8, 6)
TRIANGLE = Topology(np.array([[0, 1, 2]]), np.eye(3)[:, :2], np.array([[0, 1, 2]]))


def pair(**geometry: Any) -> Pair:
    image = np.full((*SIZE, 3), 0.5, np.float32)
    return Pair(image, image, np.ones(SIZE, np.float32), **geometry)


def mean_depth_error(judged: Pair, options: Mapping[str, str]) -> float:
    if judged.mask.sum() == 0:
        raise Unsupported("nothing there")
    return float(np.abs(judged.prediction_depth - judged.truth_depth).mean()) * {"mm": 1e3, "m": 1.0}[options["unit"]]


DEPTH = PairFamily(
    "depth-error",
    "Depth error",
    mean_depth_error,
    higher_is_better=False,
    unit="mm",
    terms=("mean",),
    perfect=0.0,
    choices={"unit": ("mm", "m")},
    needs=("prediction_depth", "truth_depth"),
)


def depth(prediction: Any, truth: Any) -> Pair:
    return pair(prediction_depth=prediction, truth_depth=truth)


def test_a_pair_metric_has_options_signature_and_header_as_all_have() -> None:
    mm, m = DEPTH.with_options({}), DEPTH.with_options({"unit": "m"})
    assert isinstance(mm, Metric)
    assert (mm.signature, m.signature) == ("depth-error|unit:mm|mean|v1", "depth-error|unit:m|mean|v1")
    assert (mm.name, m.name, m.title) == ("depth-error", "depth-error:unit=m", "Depth error (unit m)")
    assert (mm.latex, mm.unit, mm.perfect) == (r"Depth error$\downarrow$", "mm", 0.0)
    with pytest.raises(InputError, match="unknown unit of metric 'depth-error' 'km'; did you mean"):
        DEPTH.with_options({"unit": "km"})
    one, none = np.ones(SIZE), np.zeros(SIZE)
    assert [s.value for s in mm([depth(one, none), depth(one, one)])] == [1000.0, 0.0]
    assert scores([mm, m, metric("psnr")], [depth(one, none)])[0] == [
        chosen([depth(one, none)])[0] for chosen in (mm, m, metric("psnr"))
    ]


def test_what_is_missing_or_not_finite_has_no_value_and_the_reason() -> None:
    chosen = DEPTH.with_options({})
    bad = np.where(np.arange(48).reshape(SIZE) < 3, np.nan, 1.0)
    missing, untrue, damaged = chosen(
        [depth(None, np.ones(SIZE)), depth(np.ones(SIZE), None), depth(bad, np.ones(SIZE))]
    )
    assert (missing.reason, untrue.reason) == ("the method gives no depth", "the capture gives no depth")
    assert damaged.reason == "non-finite depth: 3 values"


def test_a_pair_takes_all_geometry() -> None:
    mesh = Mesh(np.eye(3), TRIANGLE)
    maps = {name: np.zeros(SIZE) for name in ("prediction_alpha", "prediction_depth", "truth_depth")}
    normals = {name: np.zeros((*SIZE, 3)) for name in ("prediction_normal", "truth_normal")}
    joints = {name: np.zeros((21, 3)) for name in ("prediction_joints", "truth_joints")}
    full = pair(**maps, **normals, **joints, prediction_mesh=mesh, truth_mesh=mesh)
    assert full.truth_mesh is mesh and metric("psnr")([full]) == metric("psnr")([pair()])


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("prediction_alpha", np.ones((6, 8)), r"prediction_alpha has shape \(6, 8\), expected \(8, 6\)"),
        ("truth_depth", np.ones((8, 6, 1)), r"truth_depth has shape \(8, 6, 1\), expected \(8, 6\)"),
        ("truth_depth", np.full(SIZE, np.nan), "truth_depth holds 48 values that are NaN or infinite"),
        ("truth_normal", np.ones(SIZE), r"truth_normal has shape \(8, 6\), expected \(8, 6, 3\)"),
        ("prediction_joints", np.ones((3, 21)), r"prediction_joints has shape \(3, 21\), expected \(J, 3\)"),
        ("prediction_mesh", np.ones((3, 3)), "prediction_mesh is a ndarray; give a handbench.scene.Mesh"),
    ],
)
def test_wrong_geometry_is_one_clear_sentence(field: str, value: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        pair(**{field: value})


def test_a_prediction_may_hold_nan_until_it_is_scored() -> None:
    pair(prediction_depth=np.full(SIZE, np.nan), prediction_joints=np.full((21, 3), np.nan))


def test_what_a_pair_of_pictures_refuses() -> None:
    image, mask = np.zeros((8, 6, 3), np.float32), np.ones((8, 6), np.float32)
    with pytest.raises(InputError, match=r"prediction \(6, 8, 3\) and truth \(8, 6, 3\)"):
        Pair(image.transpose(1, 0, 2), image, mask)
    with pytest.raises(InputError, match=r"mask \(6, 8\) does not fit the truth \(8, 6, 3\)"):
        Pair(image, image, mask.T)
    with pytest.raises(InputError, match=r"expected \(H, W, 3\)"):
        Pair(mask, mask, mask)
    with pytest.raises(InputError, match="prediction has dtype uint8"):
        Pair(image.astype(np.uint8), image, mask)
    with pytest.raises(InputError, match="truth holds 3 values"):
        Pair(image, np.where(np.arange(48).reshape(8, 6, 1) == 5, np.nan, image), mask)
