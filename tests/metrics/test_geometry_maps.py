"""Depth, normals and silhouettes against scipy, and what is compared where."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
import pytest
from scipy.spatial.distance import jaccard
from scipy.spatial.transform import Rotation

from handbench.data.openstage import open_capture
from handbench.errors import InputError
from handbench.methods.kit.picture import prediction as drawn_by
from handbench.metrics import Pair, metric
from handbench.metrics.geometry.angles import angles
from handbench.render.see.raster import Raster, rasterise
from handbench.scene import Prediction

SIZE = (12, 10)
RNG = np.random.default_rng(0)
DEPTH = RNG.uniform(0.8, 1.2, SIZE)
NORMAL = Rotation.random(SIZE[0] * SIZE[1], random_state=1).apply([0.0, 0.0, 1.0]).reshape(*SIZE, 3)
MASK = np.zeros(SIZE)
MASK[2:10, 1:8] = 1.0
PICTURE = np.zeros((*SIZE, 3))
PERFECT: dict[str, Any] = {
    "prediction_alpha": MASK,
    "prediction_depth": DEPTH,
    "truth_depth": DEPTH,
    "prediction_normal": NORMAL,
    "truth_normal": NORMAL,
}


def pair(mask: np.ndarray = MASK, **changes: Any) -> Pair:
    return Pair(PICTURE, PICTURE, mask, **{**PERFECT, **changes})


def value(spec: str, **changes: Any) -> float:
    (found,) = metric(spec)([pair(**changes)])
    assert found.value is not None, found.reason
    return found.value


def reason(spec: str, **changes: Any) -> str | None:
    (found,) = metric(spec)([pair(**changes)])
    assert found.value is None
    return found.reason


@pytest.mark.parametrize("spec", ["depth", "normal", "mask-iou"])
def test_the_truth_is_exactly_perfect(spec: str) -> None:
    assert value(spec) == metric(spec).perfect == (1.0 if spec == "mask-iou" else 0.0)


def test_depth_is_the_mean_absolute_error_in_millimetres() -> None:
    error = RNG.normal(0.0, 0.003, SIZE)
    inside = MASK > 0.5
    assert value("depth", prediction_depth=DEPTH + error) == pytest.approx(1e3 * np.abs(error[inside]).mean())
    assert value("depth", prediction_depth=DEPTH - 0.0015) == pytest.approx(1.5)


def test_normals_differ_by_the_rotation_between_them() -> None:
    """Each normal turned about an axis at right angles to it: then the angle is the rotation's magnitude."""
    axis = np.cross(NORMAL, RNG.normal(size=(*SIZE, 3)))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = RNG.uniform(0.0, np.pi, SIZE)
    turns = Rotation.from_rotvec((angle[..., None] * axis).reshape(-1, 3))
    turned = turns.apply(NORMAL.reshape(-1, 3)).reshape(*SIZE, 3)
    expected = np.degrees(turns.magnitude()).reshape(SIZE)
    np.testing.assert_allclose(angles(turned, NORMAL), expected, atol=1e-9)
    assert value("normal", prediction_normal=turned) == pytest.approx(expected[MASK > 0.5].mean())
    assert value("normal", prediction_normal=0.2 * turned) == pytest.approx(expected[MASK > 0.5].mean())
    assert value("normal", prediction_normal=-NORMAL) == pytest.approx(180.0)


def test_small_angles_survive_single_precision() -> None:
    """An arc cosine of float32 dot products says up to 0.03 degrees for equal normals."""
    single = NORMAL.astype(np.float32)
    assert angles(single, single.copy()).max() == 0.0
    tilted = NORMAL + 1e-4 * np.cross(NORMAL, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(
        angles(tilted, NORMAL), np.degrees(1e-4 * np.linalg.norm(NORMAL[..., :2], axis=-1)), rtol=1e-4
    )


def test_mask_iou_is_one_less_the_jaccard_distance() -> None:
    for _ in range(5):
        ours, theirs = RNG.random(SIZE), RNG.random(SIZE)
        expected = 1.0 - jaccard((ours > 0.5).ravel(), (theirs > 0.5).ravel())
        assert value("mask-iou", mask=theirs, prediction_alpha=ours) == pytest.approx(expected)
    assert value("mask-iou", prediction_alpha=np.roll(MASK, 7, axis=1)) < value(
        "mask-iou", prediction_alpha=np.roll(MASK, 2, axis=1)
    )


@pytest.mark.parametrize("name", ["depth", "normal"])
def test_only_pixels_of_both_silhouettes_count(name: str) -> None:
    shifted = np.roll(MASK, 3, axis=1)
    good, wild = PERFECT[f"truth_{name}"], RNG.uniform(1.0, 5.0, PERFECT[f"truth_{name}"].shape)
    overlap = (MASK * shifted).reshape(SIZE + (1,) * (good.ndim - 2))
    outside = np.where(overlap, good, wild)
    assert value(name, prediction_alpha=shifted, **{f"prediction_{name}": outside}) == 0.0
    holes = np.where(overlap * (RNG.random(overlap.shape) < 0.5), 0.0, good)  # a truth with holes says nothing there
    assert value(name, prediction_alpha=shifted, **{f"prediction_{name}": outside, f"truth_{name}": holes}) == 0.0


@pytest.mark.parametrize("name", ["depth", "normal"])
def test_why_there_is_no_score(name: str) -> None:
    ours, theirs = f"prediction_{name}", f"truth_{name}"
    good = PERFECT[theirs]
    assert reason(name, **{ours: None}) == f"the method gives no {name}"
    assert reason(name, **{theirs: None}) == f"the capture gives no {name}"
    assert reason(name, prediction_alpha=None) == "the method gives no alpha"
    assert reason(name, mask=0.0 * MASK) == "empty mask: no pixel with alpha > 0.5"
    assert "no pixel where both masks" in reason(name, prediction_alpha=1.0 - MASK)
    broken = good.copy()
    broken[4, 4] = np.nan
    assert reason(name, **{ours: broken}) == f"non-finite {name}: {broken[4, 4].size} value" + "s" * (name == "normal")
    missing = good.copy()
    missing[4, 3:6] = 0.0
    assert reason(name, **{ours: missing}) == f"the prediction has no {name} at 3 of 56 pixels it covers"


class Promised:
    """A depth map that is worked out when numpy asks: by a function, with an announced shape."""

    def __init__(self, draw: Callable[[], np.ndarray], shape: tuple[int, ...] = SIZE) -> None:
        self.shape, self._draw = shape, draw

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self._draw(), dtype=dtype, copy=copy)


def test_a_depth_in_millimetres_is_named() -> None:
    told = reason("depth", prediction_depth=1000 * PERFECT["truth_depth"])
    assert told is not None and told.startswith("the depth is ") and "prediction seems to be in millimetres" in told


def test_a_map_that_cannot_be_drawn_is_a_reason_and_no_crash() -> None:
    def crash() -> np.ndarray:
        raise RuntimeError("the worker\nis gone")

    assert value("depth", prediction_depth=Promised(lambda: DEPTH)) == 0.0
    told = "the method's depth could not be drawn: RuntimeError: the worker is gone"
    assert reason("depth", prediction_depth=Promised(crash)) == told
    assert "has shape (3,), announced was (12, 10)" in reason("depth", prediction_depth=Promised(lambda: np.ones(3)))
    assert "could not be drawn: ValueError" in reason("depth", prediction_depth=Promised(lambda: np.array("far")))
    assert value("mask-iou", prediction_depth=Promised(crash)) == 1.0
    with pytest.raises(InputError, match=r"prediction_depth has shape \(3,\)"):
        pair(prediction_depth=Promised(crash, (3,)))


def test_why_there_is_no_overlap_score() -> None:
    assert reason("mask-iou", prediction_alpha=None) == "the method gives no alpha"
    assert reason("mask-iou", mask=0.0 * MASK) == "empty mask: no pixel with alpha > 0.5"
    assert reason("mask-iou", prediction_alpha=np.nan * MASK) == "non-finite alpha: 120 values"
    assert value("mask-iou", prediction_alpha=0.0 * MASK) == 0.0


def test_signatures() -> None:
    assert metric("depth").signature == "depth|align:none|region:both-alpha>0.5|v1"
    assert metric("normal").signature == "normal|align:none|region:both-alpha>0.5|frame:world|v1"
    assert metric("mask-iou").signature == "mask-iou|region:full|mask:alpha>0.5|v1"
    assert metric("normal").latex == r"Normals$\downarrow$" and metric("mask-iou").latex == r"Mask IoU$\uparrow$"


def test_what_predictions_and_pairs_refuse() -> None:
    image, alpha = np.zeros((4, 5, 3)), np.zeros((4, 5))
    for bad, says in (
        ({"depth": np.zeros((4, 4))}, r"depth has shape \(4, 4\), expected \(4, 5\)"),
        ({"normal": alpha}, r"normal has shape \(4, 5\), expected \(4, 5, 3\)"),
        ({"joints": np.zeros((3, 2))}, r"joints have shape \(3, 2\), expected \(n, 3\)"),
        ({"mesh": alpha}, "mesh is a ndarray; give a handbench.scene.Mesh"),
    ):
        with pytest.raises(InputError, match=says):
            Prediction(image, alpha, **bad)
    with pytest.raises(InputError, match=r"truth_depth has shape \(3,\)"):
        pair(truth_depth=np.zeros(3))
    with pytest.raises(InputError, match="truth_normal holds 1 values that are NaN"):
        pair(truth_normal=np.where(np.arange(NORMAL.size).reshape(NORMAL.shape) == 7, np.nan, NORMAL))


# -- maps of a drawn mesh ---------------------------------------------------------------------------------------


def test_what_a_method_draws_is_near_the_recorded_geometry() -> None:
    """The tracked mesh is 0.3 mm off; a wrong half pixel, axis or unit would show as far more."""
    torch = pytest.importorskip("torch")
    capture = open_capture("mini")
    for frame in [f for f in capture.frames() if f.kind == "full"][:4]:
        answer = drawn_by(rasterise(frame.mesh, frame.camera), torch.zeros(3, 8, 8))
        scored = Pair.of(answer, capture.observe(frame), frame.mesh)
        depth, normal, mask = (metric(spec)([scored])[0].value for spec in ("depth", "normal", "mask-iou"))
        assert 0.05 < depth < 1.0 and 1.0 < normal < 12.0 and 0.95 < mask <= 1.0
        assert metric("vertex")([scored])[0].reason == "the method gives no mesh"


def test_maps_are_drawn_only_when_a_metric_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    torch = pytest.importorskip("torch")
    calls = []
    for name in ("depth_map", "normal_map"):
        whole = vars(Raster)[name].func
        spy = cached_property(lambda self, name=name, whole=whole: calls.append(name) or whole(self))
        spy.__set_name__(Raster, name)
        monkeypatch.setattr(Raster, name, spy)
    capture = open_capture("mini")
    frame = next(f for f in capture.frames() if f.kind == "full")
    raster = rasterise(frame.mesh, frame.camera)
    pairs = [Pair.of(drawn_by(raster, torch.zeros(3, 8, 8)), capture.observe(frame)) for _ in range(3)]
    metric("psnr")(pairs), metric("mask-iou")(pairs)
    assert calls == []
    metric("normal")(pairs)
    assert calls == ["normal_map"]  # once for all lights of a view
    metric("depth")(pairs)
    assert calls == ["normal_map", "depth_map"]
