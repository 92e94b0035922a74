"""How unsteady the error of a picture sequence is: one camera, one light, frames in the order of time.

    flicker = mean over consecutive frames, pixels and channels of |(P_t+1 - P_t) - (T_t+1 - T_t)|

in display values (linear clipped to [0, 1], then the sRGB curve), at pixels with truth alpha > 0.5 in both frames.
It is the temporal difference of the error: a constant error is steady and scores zero, and so does a change that the
truth shares. The measure is dtSSD of Erofeev et al., "Perceptually motivated benchmark for video matting", BMVC 2015,
with absolute instead of squared differences, so that it has the unit of the pictures.

It does not follow motion: an error fixed to a moving surface moves over the pixels and counts. Compare it between
methods on one sequence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from handbench.scene.colour import srgb

from ..base import Score
from ..pair import Pair
from ..view import ALPHA


@dataclass(frozen=True)
class SequenceMetric:
    """What a table must know of a metric that gives one score a sequence; see `handbench.metrics.Metric`."""

    name: str
    title: str
    signature: str
    unit: str
    higher_is_better: bool
    decimals: int
    perfect: float

    @property
    def latex(self) -> str:
        return self.title + (r"$\uparrow$" if self.higher_is_better else r"$\downarrow$")


FLICKER = SequenceMetric(
    name="flicker",
    title="Flicker",
    signature=f"flicker|region:both-alpha>{ALPHA:g}|space:srgb|order:given|power:1|motion:none|v1",
    unit="",
    higher_is_better=False,
    decimals=4,
    perfect=0.0,
)


def flicker(pairs: Sequence[Pair]) -> Score:
    """The flicker of a sequence, or the reason there is none."""
    if len(pairs) < 2:
        return Score(None, f"a sequence needs two frames or more, this one has {len(pairs)}")
    sizes = {pair.mask.shape for pair in pairs}
    if len(sizes) > 1:
        return Score(None, f"the frames of a sequence differ in size: {', '.join(map(str, sorted(sizes)))}")
    bad = sum(int(np.count_nonzero(~np.isfinite(pair.prediction))) for pair in pairs)
    if bad:
        return Score(None, f"non-finite prediction: {bad} {'value' if bad == 1 else 'values'}")
    total, count = 0.0, 0
    for earlier, later in pairwise(pairs):
        where = (earlier.mask > ALPHA) & (later.mask > ALPHA)
        change = _error(later, where) - _error(earlier, where)
        total, count = total + float(np.abs(change).sum()), count + change.size
    if not count:
        return Score(None, f"no pixel has alpha > {ALPHA:g} in two consecutive frames")
    return Score(total / count)


def _error(pair: Pair, where: np.ndarray) -> np.ndarray:
    """Prediction minus truth in display values at chosen pixels, (N, 3)."""
    return srgb(pair.prediction[where].astype(np.float64)) - srgb(pair.truth[where].astype(np.float64))
