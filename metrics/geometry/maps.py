"""Depth, normals and silhouette of a picture, pixel by pixel.

depth        mean absolute difference of depths along the camera's z, in mm
normal       mean angle between normals in the world, in degrees
mask-iou     pixels that both silhouettes cover over pixels that either covers, in the whole picture

A silhouette is alpha > 0.5. Depth and normals are compared where both silhouettes have a pixel and the truth has a
value (a depth above zero, a normal that is not zero: real captures have holes); what they leave out is `mask-iou`'s.
A prediction that covers such a pixel but has no value there has not answered, and gets a reason instead of a score.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from handbench.errors import Unsupported
from handbench.scene import Array

from ..base import PairFamily
from ..pair import Pair
from ..view import ALPHA
from .angles import angles
from .units import same_unit

_MM = 1000.0
_OVERLAP = f"region:both-alpha>{ALPHA:g}"


def _silhouettes(pair: Pair) -> tuple[Array, Array]:
    """Which pixels (H, W) prediction and truth cover. Raises `Unsupported` if the truth covers none."""
    truth = pair.mask > ALPHA
    if not truth.any():
        raise Unsupported(f"empty mask: no pixel with alpha > {ALPHA:g}")
    return np.asarray(pair.prediction_alpha) > ALPHA, truth


def _compared(pair: Pair, name: str) -> tuple[Array, Array]:
    """A map of the prediction and of the truth at the pixels (N, ...) where they are compared, N > 0."""
    prediction, truth = (np.asarray(getattr(pair, f"{side}_{name}"), np.float64) for side in ("prediction", "truth"))
    ours, theirs = _silhouettes(pair)
    where = ours & theirs & _known(truth)
    if not where.any():
        raise Unsupported(f"no pixel where both masks have alpha > {ALPHA:g} and the truth has a {name}")
    missing = int(np.count_nonzero(where & ~_known(prediction)))
    if missing:
        raise Unsupported(f"the prediction has no {name} at {missing} of {np.count_nonzero(where)} pixels it covers")
    return prediction[where], truth[where]


def _known(values: Array) -> Array:
    """Where a map has a value: a positive depth (H, W), or a normal (H, W, 3) with a length."""
    return values > 0.0 if values.ndim == 2 else (values != 0.0).any(axis=-1)


def _depth(pair: Pair, options: Mapping[str, str]) -> float:
    prediction, truth = _compared(pair, "depth")
    same_unit("the depth is", float(np.median(prediction)), float(np.median(truth)))
    return float(_MM * np.abs(prediction - truth).mean())


def _normal(pair: Pair, options: Mapping[str, str]) -> float:
    return float(angles(*_compared(pair, "normal")).mean())


def _iou(pair: Pair, options: Mapping[str, str]) -> float:
    ours, theirs = _silhouettes(pair)
    return float((ours & theirs).sum() / (ours | theirs).sum())


DEPTH = PairFamily(
    name="depth",
    title="Depth",
    measure=_depth,
    higher_is_better=False,
    unit="mm",
    decimals=2,
    terms=("align:none", _OVERLAP),
    perfect=0.0,
    needs=("prediction_alpha", "prediction_depth", "truth_depth"),
)
NORMAL = PairFamily(
    name="normal",
    title="Normals",
    measure=_normal,
    higher_is_better=False,
    unit="deg",
    decimals=2,
    terms=("align:none", _OVERLAP, "frame:world"),
    perfect=0.0,
    needs=("prediction_alpha", "prediction_normal", "truth_normal"),
)
MASK = PairFamily(
    name="mask-iou",
    title="Mask IoU",
    measure=_iou,
    higher_is_better=True,
    terms=("region:full", f"mask:alpha>{ALPHA:g}"),
    perfect=1.0,
    needs=("prediction_alpha",),
)
