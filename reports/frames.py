"""What a run answered to each frame, and how a frame is shown: cut to the hand, with one exposure for all pictures."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from handbench.errors import Damaged, InputError
from handbench.results.measured import ScoredFrame
from handbench.results.record import CellRecord
from handbench.scene import Array
from handbench.scene.colour import srgb

from .run import Run

EXPOSED = 0.8  # the display-linear value that the 99th percentile of the truth is brought to
MARGIN = 0.06  # of the hand's size, around the hand
KINDS: Mapping[str, str] = {  # of every `FrameKind`, in the order of a report
    "olat": "One light at a time",
    "group": "Group of lights",
    "full": "Fully lit",
    "environment": "Environment map",
}


@dataclass(frozen=True)
class Answer:
    """What a method's cell says of one query."""

    cell: CellRecord
    frame: ScoredFrame

    @property
    def kind(self) -> str:
        return self.frame.kind

    def value(self, signature: str) -> float | None:
        """The score of a metric, or None."""
        return dict(zip(self.cell.metrics, self.frame.values, strict=True)).get(signature)

    def picture(self, run: Run, query: str) -> tuple[Array | None, str]:
        """The linear picture (H, W, 3), or None and why there is none: a report is about what there is.

        Raises `Damaged` for a picture that is not what was written.
        """
        if query not in self.cell.predictions:
            return None, self.frame.reason or "no picture was kept"
        try:
            return run.read_prediction(self.cell, query).image, ""
        except Damaged:
            raise
        except InputError as error:
            return None, self.frame.reason or str(error)


def answers(run: Run) -> dict[str, dict[str, Answer]]:
    """By method and query; of several seeds the first in the plan that has the query."""
    found: dict[str, dict[str, Answer]] = defaultdict(dict)
    for cell in run.cells:
        of_method = found[cell.method.name]
        for frame in cell.scores:
            of_method.setdefault(frame.query, Answer(cell, frame))
    return found


@dataclass(frozen=True)
class Framing:
    """Where to look in a frame, and how brightly: a box in pixels of the image's own proportions, and a factor.

    What lies outside the image is black.
    """

    top: int
    left: int
    height: int
    width: int
    exposure: float

    @staticmethod
    def of(image: Array, alpha: Array) -> Framing:
        """The view that suits a linear picture (H, W, 3) with alpha (H, W): the truth's serves all methods."""
        bright = np.percentile(image[alpha > 0.5], 99) if (alpha > 0.5).any() else 1.0
        exposure = float(EXPOSED / max(bright, 1e-6))
        rows, columns = np.nonzero(alpha > 0.01)
        if not len(rows):
            return Framing(0, 0, alpha.shape[0], alpha.shape[1], exposure)
        top, bottom, left, right = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
        share = max((bottom - top) / alpha.shape[0], (right - left) / alpha.shape[1]) * (1 + 2 * MARGIN)
        height, width = (int(np.ceil(share * side)) for side in alpha.shape)
        return Framing(int(top + bottom - height) // 2, int(left + right - width) // 2, height, width, exposure)

    def __call__(self, image: Array) -> Array:
        """What is shown of a linear picture: (height, width, 3) in sRGB, in [0, 1]."""
        return srgb(self.linear(image))

    def linear(self, image: Array) -> Array:
        """A linear picture cut and exposed: (height, width, 3), 1 is white and there may be more."""
        shown = np.zeros((self.height, self.width, 3), image.dtype)
        top, left = max(self.top, 0), max(self.left, 0)
        inside = image[top : self.top + self.height, left : self.left + self.width]
        shown[top - self.top :, left - self.left :][: inside.shape[0], : inside.shape[1]] = inside
        return shown * self.exposure
