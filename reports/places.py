"""Where labels stand beside their points, so that none covers another, a point or the line of the front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from handbench.scene import Array

Spot: TypeAlias = tuple[float, float]

SIZE = 11  # the height of the letters' line
MARK = 4.5  # the radius of a point
_WIDE, _NARROW, _LETTER = 0.82, 0.34, 0.6  # widths of letters, of `SIZE`; generous, as the reader's font is unknown
_DISTANCES = (3.0, 12.0, 22.0, 34.0, 48.0, 64.0, 82.0, 102.0, 124.0)
_DIRECTIONS = ((1, 0), (-1, 0), (0, -1), (0, 1), (1, -1), (-1, -1), (1, 1), (-1, 1))
_LABEL, _LINE = 10.0, 0.5  # what covering an area costs, in distance
_ROUNDS = 4
_LEADER = 5.0  # labels further away than this have a line to their point


class PlotBox(NamedTuple):
    left: float
    top: float
    right: float
    bottom: float

    def overlap(self, other: PlotBox) -> float:
        """The area that both share."""
        width = min(self.right, other.right) - max(self.left, other.left)
        height = min(self.bottom, other.bottom) - max(self.top, other.top)
        return max(width, 0.0) * max(height, 0.0)

    def outside(self, frame: PlotBox) -> float:
        """The area that is not inside the frame."""
        return (self.right - self.left) * (self.bottom - self.top) - self.overlap(frame)


@dataclass(frozen=True)
class Label:
    """A text at (x, y), its base line's start, middle or end; `leader` says where its line to the point ends."""

    text: str
    x: float
    y: float
    anchor: Literal["start", "middle", "end"]
    box: PlotBox
    leader: Spot | None


def placed(texts: Sequence[str], spots: Sequence[Spot], line: Sequence[Spot], frame: PlotBox) -> tuple[Label, ...]:
    """A label for each spot, all inside the frame if there is room.

    Each takes the nearest place that covers least; other labels and points weigh most, the line less. Those in a crowd
    choose first, and all may choose again once the others stand.
    """
    marks = [PlotBox(x - MARK, y - MARK, x + MARK, y + MARK) for x, y in spots]
    lines = [_thick(one, other) for one, other in pairwise(line)]
    choices = [_candidates(text, *spot) for text, spot in zip(texts, spots, strict=True)]
    fixed = [
        np.array([distance for distance, _ in of_spot])
        + _LABEL * (_covered(of_spot, marks) + np.array([label.box.outside(frame) for _, label in of_spot]))
        + _LINE * _covered(of_spot, lines)
        for of_spot in choices
    ]
    crowd = [sum(abs(x - u) < 60 and abs(y - v) < 30 for u, v in spots) for x, y in spots]
    order = sorted(range(len(spots)), key=lambda i: (-crowd[i], i))
    found: dict[int, Label] = {}
    for i in order * _ROUNDS:
        others = [label.box for j, label in found.items() if j != i]
        found[i] = choices[i][int(np.argmin(fixed[i] + _LABEL * _covered(choices[i], others)))][1]
    return tuple(found[i] for i in range(len(spots)))


def _covered(candidates: Sequence[tuple[float, Label]], boxes: Sequence[PlotBox]) -> Array:
    """The area of the boxes that each candidate covers."""
    own = np.array([label.box for _, label in candidates])[:, None]
    other = np.array(boxes).reshape(1, -1, 4)
    sides = np.minimum(own[..., 2:], other[..., 2:]) - np.maximum(own[..., :2], other[..., :2])
    return np.asarray(sides.clip(0).prod(axis=-1).sum(axis=-1))


def width(text: str) -> float:
    """About how wide a text is, rather too wide."""
    wide = sum(letter in "MWmw@%ΣÄÖ" or letter.isupper() for letter in text)
    narrow = sum(letter in "iljtfrI.,:;'|!()/- " for letter in text)
    return SIZE * (wide * _WIDE + narrow * _NARROW + (len(text) - wide - narrow) * _LETTER)


def _candidates(text: str, x: float, y: float) -> list[tuple[float, Label]]:
    found, wide = [], width(text)
    for far in _DISTANCES:
        for across, down in _DIRECTIONS:
            reach = MARK + (far if not (across and down) else 0.7 * far)
            found.append((far + abs(down), _label(text, wide, x, y, across * reach, down * reach)))
    return found


def _label(text: str, wide: float, x: float, y: float, dx: float, dy: float) -> Label:
    """The label of a width whose nearest edge or corner is (dx, dy) from the point."""
    ascent, descent = 0.78 * SIZE, 0.24 * SIZE
    middle = y + dy + (0.5 if dy > 0 else -0.5 if dy < 0 else 0.0) * (ascent + descent)
    left = x + dx - (0.0 if dx > 0 else wide if dx < 0 else wide / 2)
    box = PlotBox(left, middle - SIZE / 2, left + wide, middle + SIZE / 2)
    anchor: Literal["start", "middle", "end"] = "start" if dx > 0 else "end" if dx < 0 else "middle"
    leader = (x + 0.9 * dx, y + 0.9 * dy) if max(abs(dx), abs(dy)) - MARK > _LEADER else None
    return Label(text, x + dx, middle + (ascent - descent) / 2, anchor, box, leader)


def _thick(one: Spot, other: Spot) -> PlotBox:
    """A level or upright line as a box of its own thickness."""
    (x, y), (u, v) = one, other
    return PlotBox(min(x, u) - 1, min(y, v) - 1, max(x, u) + 1, max(y, v) + 1)
