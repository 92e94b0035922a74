"""Which frames a report shows, and how they look: truth, every method, and where each is wrong.

Images are shown in sRGB with one exposure a frame, chosen from the truth and the same for all methods.
The error map is the mean over R, G, B of the absolute difference of those displayed values.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from statistics import mean
from typing import Any

import numpy as np

from handbench.errors import InputError
from handbench.metrics import srgb
from handbench.scene import Array

from .run import Run
from .truth import prediction, truth_of

KINDS = ("olat", "group", "full", "environment")
KIND_TITLES = {
    "olat": "One light at a time",
    "group": "Group of lights",
    "full": "Fully lit",
    "environment": "Environment map",
}
SUBJECTS = 2
ERROR_SCALE = 0.2  # the error that gets the brightest colour
EXPOSED = 0.8  # the display-linear value that the 99th percentile of the truth is brought to
MARGIN = 0.06  # of the hand's size, around the hand


@dataclass(frozen=True)
class Tile:
    """A method's answer: image (H, W, 3) in sRGB and error (H, W), both in [0, 1], or None and the reason."""

    title: str
    score: float | None
    image: Array | None
    error: Array | None
    reason: str = ""


@dataclass(frozen=True)
class Panel:
    """One frame: the truth (H, W, 3) in sRGB and a tile for every method that is not itself the truth."""

    query: str
    kind: str
    exposure: float
    truth: Array
    tiles: tuple[Tile, ...]


def panels(run: Run) -> Iterator[Panel]:
    """A typical frame of up to two subjects for each kind of light; frames without truth are left out."""
    truth = truth_of(run)
    for kind, query in chosen(run):
        recorded = truth(query)
        if recorded is not None:
            yield _panel(run, kind, query, *recorded)


def chosen(run: Run) -> list[tuple[str, str]]:
    """(kind, query) pairs: for the first and the last subject, the frame of median score over the methods.

    The score is the protocol's first metric; so no frame is picked by hand.
    """
    signature = run.plan["protocol"]["metrics"][0]["signature"]
    truths = {info["name"] for info in run.plan["methods"] if info["truth"]}
    scores: dict[tuple[str, str], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for cell in run.cells:
        if cell["method"]["name"] in truths:
            continue
        for score in cell["scores"]:
            if score["metric"] == signature and score["value"] is not None:
                scores[score["kind"], cell["subject"]][score["query"]].append(score["value"])
    found = []
    for kind in KINDS:
        subjects = sorted(subject for of_kind, subject in scores if of_kind == kind)
        for subject in dict.fromkeys([*subjects[:1], *subjects[1:][-(SUBJECTS - 1) :]]):
            queries = scores[kind, subject]
            order = sorted(queries, key=lambda query: (mean(queries[query]), query))
            found.append((kind, order[len(order) // 2]))
    return found


def _panel(run: Run, kind: str, query: str, image: Array, alpha: Array) -> Panel:
    crop = _Crop.around(alpha)
    bright = np.percentile(image[alpha > 0.5], 99) if (alpha > 0.5).any() else 1.0
    exposure = float(EXPOSED / max(bright, 1e-6))
    shown = srgb(crop(image) * exposure)
    tiles = []
    for info in run.plan["methods"]:
        if not info["truth"]:
            tiles.append(_tile(info["title"], run.of_method(info["name"]), run, query, crop, exposure, shown))
    return Panel(query, kind, exposure, shown, tuple(tiles))


def _tile(
    title: str, cells: Iterable[dict[str, Any]], run: Run, query: str, crop: _Crop, exposure: float, shown: Array
) -> Tile:
    signature = run.plan["protocol"]["metrics"][0]["signature"]
    for cell in cells:
        of_query = [score for score in cell["scores"] if score["query"] == query and score["metric"] == signature]
        if not of_query:
            continue
        score = of_query[0]
        if score["value"] is None:
            return Tile(title, None, None, None, score["reason"] or "no value")
        try:
            image = srgb(crop(prediction(run, cell, query)[0]) * exposure)
        except InputError as error:
            return Tile(title, score["value"], None, None, str(error))
        return Tile(title, score["value"], image, np.abs(image - shown).mean(axis=-1))
    return Tile(title, None, None, None, "not computed")


@dataclass(frozen=True)
class _Crop:
    """A box around the hand in pixels, of the image's own proportions; what lies outside the image is black."""

    top: int
    left: int
    height: int
    width: int

    @staticmethod
    def around(alpha: Array) -> _Crop:
        rows, columns = np.nonzero(alpha > 0.01)
        if not len(rows):
            return _Crop(0, 0, *alpha.shape)
        top, bottom, left, right = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
        share = max((bottom - top) / alpha.shape[0], (right - left) / alpha.shape[1]) * (1 + 2 * MARGIN)
        height, width = (int(np.ceil(share * side)) for side in alpha.shape)
        return _Crop(int(top + bottom - height) // 2, int(left + right - width) // 2, height, width)

    def __call__(self, image: Array) -> Array:
        padded = np.pad(image, ((self.height, self.height), (self.width, self.width), (0, 0)))
        top, left = self.top + self.height, self.left + self.width
        return padded[top : top + self.height, left : left + self.width]
