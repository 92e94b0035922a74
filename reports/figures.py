"""Which frames a report shows, and how they look: truth, every method, and where each is wrong.

Images are shown in sRGB with one exposure a frame, chosen from the truth and the same for all methods.
The error map is the mean over R, G, B of the absolute difference of those displayed values.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from statistics import mean

import numpy as np

from handbench.scene import Array

from .frames import KINDS, Answer, View, answers
from .run import Run
from .truth import truth_of

SUBJECTS = 2
ERROR_SCALE = 0.2  # the error that gets the brightest colour
DETAIL = 0.28  # the side of the detail, of the shorter side of the picture


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
    truth, given = truth_of(run), answers(run)
    for kind, query in chosen(run):
        recorded = truth(query)
        if recorded is not None:
            yield _panel(run, given, kind, query, *recorded)


def chosen(run: Run) -> list[tuple[str, str]]:
    """(kind, query) pairs: for the first and the last subject, the frame of median score over the methods.

    The score is the protocol's first metric; so no frame is picked by hand.
    """
    signature = run.plan.protocol.metrics[0].signature
    truths = {method.name for method in run.plan.methods if method.truth}
    scores: dict[tuple[str, str], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for cell in run.cells:
        if cell.method.name in truths or signature not in cell.metrics:
            continue
        place = cell.metrics.index(signature)
        for frame in cell.scores:
            if (value := frame.values[place]) is not None:
                scores[frame.kind, cell.subject][frame.query].append(value)
    found = []
    for kind in KINDS:
        subjects = sorted(subject for of_kind, subject in scores if of_kind == kind)
        for subject in dict.fromkeys([*subjects[:1], *subjects[1:][-(SUBJECTS - 1) :]]):
            queries = scores[kind, subject]
            order = sorted(queries, key=lambda query: (mean(queries[query]), query))
            found.append((kind, order[len(order) // 2]))
    return found


def detail(panel: Panel) -> tuple[slice, slice]:
    """Rows and columns of the square in which the typical answer is most wrong: the median of the error over methods.

    The median lets no single bad method choose, and no one picks by hand. With no answer, the square is the middle.
    """
    side = max(2, round(DETAIL * min(panel.truth.shape[:2])))
    errors = [tile.error for tile in panel.tiles if tile.error is not None]
    height, width = panel.truth.shape[:2]
    row, column = (height - side) // 2, (width - side) // 2
    if errors:
        sums = np.pad(np.median(errors, axis=0), ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
        windows = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
        row, column = (int(i) for i in np.unravel_index(np.argmax(windows.round(9)), windows.shape))
    return slice(row, row + side), slice(column, column + side)


def _panel(
    run: Run, given: Mapping[str, Mapping[str, Answer]], kind: str, query: str, image: Array, alpha: Array
) -> Panel:
    view = View.of(image, alpha)
    shown = view(image)
    tiles = [
        _tile(method.title, given.get(method.name, {}).get(query), run, query, view, shown)
        for method in run.plan.methods
        if not method.truth
    ]
    return Panel(query, kind, view.exposure, shown, tuple(tiles))


def _tile(title: str, answer: Answer | None, run: Run, query: str, view: View, truth: Array) -> Tile:
    if answer is None:
        return Tile(title, None, None, None, "not computed")
    score = answer.value(run.plan.protocol.metrics[0].signature)
    picture, reason = answer.picture(run, query)
    if picture is None:
        return Tile(title, score, None, None, reason)
    image = view(picture)
    return Tile(title, score, image, np.abs(image - truth).mean(axis=-1))
