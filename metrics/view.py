"""What an image metric looks at: the pixels of a pair, aligned, in the metric's colour space, cut to its region.

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

from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from handbench.errors import Unsupported
from handbench.scene.colour import srgb

from .pair import Pair

T = TypeVar("T")

ALPHA = 0.5
BOX_MARGIN = 8
BLACK = 1e-6  # linear, far below what is shown or measured

REGIONS = ("mask", "box", "full")
SPACES = ("srgb", "linear")
SCALES = ("none", "scalar", "rgb")

Box: TypeAlias = tuple[slice, slice]
"""Rows and columns."""

_AROUND = 18  # pixels around the mask that are prepared at once: enough for `box` and FLIP's filter beyond it


@dataclass(frozen=True, eq=False)
class View:
    """A cut of a pair: prediction and truth (h, w, 3) float64, read-only; `support` (h, w), the pixels that count."""

    prediction: NDArray[np.float64]
    truth: NDArray[np.float64]
    support: NDArray[np.bool_]
    region: str


class Recent:
    """The last few values by key: what pairs that follow each other share, such as the surfaces of a pose."""

    def __init__(self, most: int = 4) -> None:
        self._most = most
        self._held: OrderedDict[Hashable, Any] = OrderedDict()

    def __call__(self, key: Hashable, make: Callable[[], T]) -> T:
        """The value of a key, made if it is not among the last ones."""
        self._held[key] = found = self._held.pop(key) if key in self._held else make()
        while len(self._held) > self._most:
            self._held.popitem(last=False)
        return cast(T, found)


class Looks:
    """All views of one pair; what several of them need, such as the sRGB curve, is computed once.

    `recent` is what the pairs before it left.
    """

    def __init__(self, pair: Pair, recent: Recent | None = None) -> None:
        self.pair = pair
        self.recent = recent or Recent()
        self._prepared: dict[tuple[str, str, bool], tuple[NDArray[np.float64], NDArray[np.float64]]] = {}

    def view(self, options: Mapping[str, str], context: int = 0, least: int = 1) -> View:
        """The view under the options "region", "space" and "scale".

        The cut reaches `context` pixels beyond the region where the image does, and is `least` pixels wide and high.
        Raises `Unsupported` if the prediction is not finite, the needed mask is empty, or the image is too small.
        """
        if self.bad:
            raise Unsupported(f"non-finite prediction: {self.bad} {'value' if self.bad == 1 else 'values'}")
        height, width = self.mask.shape
        if min(height, width) < least:
            raise Unsupported(f"image of {height}x{width} pixels is smaller than the {least}x{least} the metric needs")
        region, scale = options["region"], options["scale"]
        if self.hand is None and (region != "full" or scale != "none"):
            raise Unsupported(f"empty mask: no pixel with alpha > {ALPHA:g}")

        if self.hand is None or region == "full":
            inside = cut = (slice(0, height), slice(0, width))
        else:
            inside = _grown(self.hand, BOX_MARGIN if region == "box" else 0, 1, self.mask.shape)
            cut = _grown(inside, context, least, self.mask.shape)
        support = self.mask[cut]
        if region != "mask":
            support = np.zeros_like(support)
            support[_within(inside, cut)] = True
        prediction, truth = self._cut(cut, scale, options["space"])
        return View(prediction, truth, support, region)

    @cached_property
    def bad(self) -> int:
        """How many values of the prediction are NaN or infinite."""
        return int(np.count_nonzero(~np.isfinite(self.pair.prediction)))

    @cached_property
    def mask(self) -> NDArray[np.bool_]:
        """Where the hand is, (H, W)."""
        return self.pair.mask > ALPHA

    @cached_property
    def hand(self) -> Box | None:
        """The bounding box of the mask, None if it is empty."""
        rows, columns = (np.flatnonzero(self.mask.any(axis=axis)) for axis in (1, 0))
        if not len(rows):
            return None
        return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)

    def _cut(self, cut: Box, scale: str, space: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Prediction and truth in the cut: read-only parts of what is prepared around the hand, or of all."""
        whole = (slice(0, self.mask.shape[0]), slice(0, self.mask.shape[1]))
        around = whole if self.hand is None else _grown(self.hand, _AROUND, 1, self.mask.shape)
        if not all(big.start <= small.start and small.stop <= big.stop for big, small in zip(around, cut, strict=True)):
            around = whole
        key = (scale, space, around == whole)
        if key not in self._prepared:
            self._prepared[key] = self._prepare(around, scale, space)
        prediction, truth = self._prepared[key]
        part = _within(cut, around)
        return prediction[part], truth[part]

    def _prepare(self, cut: Box, scale: str, space: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        prediction, truth = (image[cut].astype(np.float64) for image in (self.pair.prediction, self.pair.truth))
        if scale != "none":
            inside = self.mask[cut]
            prediction *= _factor(prediction[inside], truth[inside], scale)
        if space == "srgb":
            prediction, truth = srgb(prediction), srgb(truth)
        for image in (prediction, truth):
            image.flags.writeable = False
        return prediction, truth


def _grown(box: Box, margin: int, least: int, shape: tuple[int, ...]) -> Box:
    """The box with a margin, then of the least size, within an image of `shape`."""
    rows, columns = (_grown_side(side, margin, least, size) for side, size in zip(box, shape, strict=True))
    return rows, columns


def _grown_side(side: slice, margin: int, least: int, size: int) -> slice:
    first, last = max(side.start - margin, 0), min(side.stop + margin, size)
    lack = max(least - (last - first), 0)
    first = min(max(first - lack // 2, 0), size - (last - first) - lack)
    return slice(first, max(last, first + least))


def _within(box: Box, outer: Box) -> Box:
    """A box in the coordinates of one that holds it."""
    rows, columns = (slice(b.start - o.start, b.stop - o.start) for b, o in zip(box, outer, strict=True))
    return rows, columns


def _factor(prediction: NDArray[np.float64], truth: NDArray[np.float64], scale: str) -> NDArray[np.float64]:
    """The non-negative least-squares factor of (N, 3) pixels: (1,) or (3,); 1 where the prediction is black.

    Raises `Unsupported` for a truth, or with "rgb" a channel of it, that is black: any prediction would fit it.
    """
    axis = 0 if scale == "rgb" else None
    dark = np.atleast_1d(np.abs(truth).max(axis=axis) <= BLACK)
    if dark.any():
        which = "truth" if dark.all() else "truth's " + ", ".join(np.array(("red", "green", "blue"))[dark])
        raise Unsupported(f"the {which} is black in the mask: there is nothing to fit a scale to")
    energy, match = np.sum(prediction**2, axis=axis), np.sum(prediction * truth, axis=axis)
    black = energy == 0
    return np.atleast_1d(np.where(black, 1.0, np.maximum(match, 0.0) / np.where(black, 1.0, energy)))
