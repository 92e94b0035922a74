"""Peak signal-to-noise ratio, 10 log10(1 / MSE), over the pixels and channels of the region.

Averaged per image, as papers do, not pooled over a set. Equal images would score infinity, which JSON cannot hold
and which would swamp an average: the value is capped at 100 dB, and the signature says so.
"""

from __future__ import annotations

import math

import numpy as np

from .base import Family
from .view import View

CAP = 100.0


def psnr(view: View) -> float:
    """PSNR in dB, peak 1, at most `CAP`."""
    difference = (view.prediction - view.truth)[view.support]
    error = float(np.mean(np.square(difference, out=difference)))
    return CAP if error <= 10 ** (-CAP / 10) else -10.0 * math.log10(error)


PSNR = Family(
    "psnr",
    "PSNR",
    psnr,
    higher_is_better=True,
    unit="dB",
    decimals=2,
    terms=("peak:1", f"cap:{CAP:g}"),
    perfect=CAP,
)
