"""Which frames a report shows, and how they look: truth, every method, and where each is wrong.

Images are shown in sRGB with one exposure a frame, chosen from the truth and the same for all methods.
The error map is the mean over R, G, B of the absolute difference of those displayed values.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import mean
from typing import TypeAlias

import numpy as np

from handbench.scene import Array

from .frames import KINDS, Answer, Framing, answers
from .run import Run
from .truth import truth_of

Square: TypeAlias = tuple[int, int, int]
"""A square of a picture: left, top and side in pixels."""

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
    """One frame: the truth (H, W, 3) in sRGB and a tile for every method that is not itself the truth.

    `square` is a detail that was asked for: left, top and side in pixels of the truth that is shown.
    """

    query: str
    kind: str
    exposure: float
    truth: Array
    tiles: tuple[Tile, ...]
    square: Square | None = None


def panels(
    run: Run, queries: Sequence[str] | None = None, square: Square | None = None, whole: Run | None = None
) -> Iterator[Panel]:
    """Frames of some queries, or a typical one of up to two subjects for each kind of light; those without truth are
    left out.

    square      the detail of each, in pixels of the recorded picture
    whole       the run that has the truth, if `run` is a selection of it
    """
    truth, given = truth_of(whole or run), answers(run)
    kinds = {frame.query: frame.kind for cell in run.cells for frame in cell.scores}
    for kind, query in chosen(run) if queries is None else [(kinds[q], q) for q in queries if q in kinds]:
        recorded = truth(query)
        if recorded is not None:
            yield _panel(run, given, kind, query, *recorded, square)


def chosen(run: Run) -> list[tuple[str, str]]:
    """(kind, query) pairs: for the first and the last subject, the frame of median score over the methods.

    The score is the protocol's first metric; so no frame is picked by hand.
    """
    signature = run.plan.protocol.metrics[0].signature
    truths = {method.name for method in run.plan.methods if method.truth}
    shown = {query for column in run.plan.protocol.columns for query in column.queries}
    scores: dict[tuple[str, str], dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for cell in run.cells:
        if cell.method.name in truths or signature not in cell.metrics:
            continue
        place = cell.metrics.index(signature)
        for frame in (frame for frame in cell.scores if frame.query in shown):
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
    """Rows and columns of the square that was asked for, or of the one in which the typical answer is most wrong: the
    median of the error over methods.

    The median lets no single bad method choose, and no one picks by hand. With no answer, the square is the middle.
    """
    if panel.square is not None:
        return _inside(panel.square, panel.truth.shape)
    side = max(2, round(DETAIL * min(panel.truth.shape[:2])))
    errors = [tile.error for tile in panel.tiles if tile.error is not None]
    height, width = panel.truth.shape[:2]
    row, column = (height - side) // 2, (width - side) // 2
    if errors:
        sums = np.pad(np.median(errors, axis=0), ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
        windows = sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]
        row, column = (int(i) for i in np.unravel_index(np.argmax(windows.round(9)), windows.shape))
    return slice(row, row + side), slice(column, column + side)


def _inside(square: Square, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """A square's rows and columns, moved into the picture if it sticks out."""
    left, top, side = square
    side = min(side, *shape[:2])
    row, column = (int(np.clip(at, 0, size - side)) for at, size in ((top, shape[0]), (left, shape[1])))
    return slice(row, row + side), slice(column, column + side)


def _panel(
    run: Run,
    given: Mapping[str, Mapping[str, Answer]],
    kind: str,
    query: str,
    image: Array,
    alpha: Array,
    square: Square | None,
) -> Panel:
    view = Framing.of(image, alpha)
    shown = view(image)
    tiles = [
        _tile(method.title, given.get(method.name, {}).get(query), run, query, view, shown)
        for method in run.plan.methods
        if not method.truth
    ]
    moved = None if square is None else (square[0] - view.left, square[1] - view.top, square[2])
    return Panel(query, kind, view.exposure, shown, tuple(tiles), moved)


def _tile(title: str, answer: Answer | None, run: Run, query: str, view: Framing, truth: Array) -> Tile:
    if answer is None:
        return Tile(title, None, None, None, "not computed")
    score = answer.value(run.plan.protocol.metrics[0].signature)
    picture, reason = answer.picture(run, query)
    if picture is None:
        return Tile(title, score, None, None, reason)
    image = view(picture)
    return Tile(title, score, image, np.abs(image - truth).mean(axis=-1))
