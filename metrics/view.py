"""What a metric looks at: the pixels of a pair, aligned, in the metric's colour space, cut to its region.

Region   mask   the pixels with truth alpha > 0.5
         box    the bounding box of the mask and a margin of 8 pixels, within the image
         full   the whole image
Scale    none | scalar | rgb: one factor, or one a channel, multiplies the linear prediction so that it is the
         least-squares fit to the linear truth in the mask; never negative
Space    linear   scene-referred, not clipped
         srgb     clipped to [0, 1], then the sRGB transfer curve

Images are premultiplied over black (see `handbench.scene`), so outside the hand the truth is black, and a
prediction that bleeds out of the silhouette pays for it in `box` and `full`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handbench.errors import InputError, Unsupported

ALPHA = 0.5
BOX_MARGIN = 8

REGIONS = ("mask", "box", "full")
SPACES = ("srgb", "linear")
SCALES = ("none", "scalar", "rgb")


@dataclass(frozen=True, eq=False)
class Pair:
    """A prediction and its truth, (H, W, 3) linear premultiplied, and the truth's alpha `mask` (H, W).

    Raises `InputError` if the shapes differ, if an image holds integers, or if the truth or the mask is not finite.
    A prediction with NaN is no error: its score says so.
    """

    prediction: NDArray[Any]
    truth: NDArray[Any]
    mask: NDArray[Any]

    def __post_init__(self) -> None:
        prediction, truth, mask = (np.asarray(a) for a in (self.prediction, self.truth, self.mask))
        if prediction.shape != truth.shape:
            raise InputError(f"prediction {prediction.shape} and truth {truth.shape} differ in shape; draw at its size")
        if truth.ndim != 3 or truth.shape[2] != 3 or truth.size == 0:
            raise InputError(f"prediction and truth have shape {truth.shape}, expected (H, W, 3)")
        if mask.shape != truth.shape[:2]:
            raise InputError(f"mask {mask.shape} does not fit the truth {truth.shape}, expected {truth.shape[:2]}")
        for name, image in (("prediction", prediction), ("truth", truth)):
            if image.dtype.kind != "f":
                raise InputError(
                    f"{name} has dtype {image.dtype}; give linear floating-point values, not display codes"
                )
        for name, array in (("truth", truth), ("mask", mask)):
            bad = int(np.count_nonzero(~np.isfinite(array)))
            if bad:
                raise InputError(f"{name} holds {bad} values that are NaN or infinite; the capture is damaged")
        for name, array in (("prediction", prediction), ("truth", truth), ("mask", mask)):
            object.__setattr__(self, name, array)


@dataclass(frozen=True, eq=False)
class View:
    """A cut of a pair: prediction and truth (h, w, 3) float64, and `support` (h, w), the pixels that count."""

    prediction: NDArray[np.float64]
    truth: NDArray[np.float64]
    support: NDArray[np.bool_]
    region: str


def look(pair: Pair, options: Mapping[str, str], context: int = 0, least: int = 1) -> View:
    """The view of a pair under the options "region", "space" and "scale".

    The cut reaches `context` pixels beyond the region where the image does, and is `least` pixels wide and high.
    Raises `Unsupported` if the prediction is not finite, the needed mask is empty, or the image is too small.
    """
    bad = int(np.count_nonzero(~np.isfinite(pair.prediction)))
    if bad:
        raise Unsupported(f"non-finite prediction: {bad} {'value' if bad == 1 else 'values'}")
    height, width = pair.mask.shape
    if min(height, width) < least:
        raise Unsupported(f"image of {height}x{width} pixels is smaller than the {least}x{least} the metric needs")
    mask = pair.mask > ALPHA
    region, scale = options["region"], options["scale"]
    if not mask.any() and (region != "full" or scale != "none"):
        raise Unsupported(f"empty mask: no pixel with alpha > {ALPHA:g}")

    support = mask
    if region != "mask":
        support = np.zeros_like(mask)
        support[_box(mask, BOX_MARGIN) if region == "box" else ...] = True
    cut = _box(support, context, least)

    prediction, truth, mask = pair.prediction[cut].astype(np.float64), pair.truth[cut].astype(np.float64), mask[cut]
    if scale != "none":
        prediction = prediction * _factor(prediction[mask], truth[mask], scale)
    if options["space"] == "srgb":
        prediction, truth = srgb(prediction), srgb(truth)
    return View(prediction, truth, support[cut], region)


def srgb(linear: NDArray[Any]) -> NDArray[Any]:
    """Linear Rec. 709 values, any shape, clipped to [0, 1] and encoded for display (IEC 61966-2-1)."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.power(np.maximum(x, 0.0031308), 1 / 2.4) - 0.055)


def _box(support: NDArray[np.bool_], margin: int = 0, least: int = 1) -> tuple[slice, slice]:
    """Rows and columns of the bounding box, grown by the margin, then to the least size, within the image."""
    cuts = []
    for axis in (0, 1):
        size = support.shape[axis]
        inside = np.flatnonzero(support.any(axis=1 - axis))
        first, last = max(int(inside[0]) - margin, 0), min(int(inside[-1]) + 1 + margin, size)
        lack = max(least - (last - first), 0)
        first = min(max(first - lack // 2, 0), size - (last - first) - lack)
        cuts.append(slice(first, max(last, first + least)))
    return cuts[0], cuts[1]


def _factor(prediction: NDArray[np.float64], truth: NDArray[np.float64], scale: str) -> NDArray[np.float64]:
    """The non-negative least-squares factor of (N, 3) pixels: (1,) or (3,); 1 where the prediction is black."""
    axis = 0 if scale == "rgb" else None
    energy, match = np.sum(prediction**2, axis=axis), np.sum(prediction * truth, axis=axis)
    black = energy == 0
    return np.atleast_1d(np.where(black, 1.0, np.maximum(match, 0.0) / np.where(black, 1.0, energy)))
