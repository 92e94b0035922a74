"""Multi-scale structural similarity (Wang, Simoncelli, Bovik, Asilomar 2003), computed by pytorch-msssim in float64.

    for each channel    product over scales 1…4 of c_s ^ w_s, times l_5 ^ w_5;  the mean over the channels

c_s is the mean over the map of contrast times structure at scale s, l_5 that of the whole SSIM at the last one; means
are taken before powers, and one below zero counts as zero. w = .0448, .2856, .3001, .2363, .1333. From scale to scale
two by two pixels are averaged, odd sides first surrounded by zeros. 11-pixel Gaussian windows lie wholly inside the
picture. The smallest scale is a sixteenth of the picture, so the picture has more than 160 pixels a side; a smaller box
grows into its image, and in a smaller image the metric is not defined.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from pytorch_msssim import ms_ssim
from torch import Tensor

from .base import Family
from .ssim import gaussian_window
from .view import View

LEAST = 161
# the library's own window is float32: it does not sum to 1 and moves flat pictures by 1e-5
_WINDOW = torch.from_numpy(gaussian_window()).expand(3, 1, 1, -1)


def msssim(view: View) -> float:
    """Mean over the channels, in [0, 1]: a scale with negative correlation counts as zero."""
    return float(ms_ssim(_batch(view.prediction), _batch(view.truth), data_range=1.0, win=_WINDOW))


def _batch(image: NDArray[np.float64]) -> Tensor:
    return torch.from_numpy(image.transpose(2, 0, 1).copy())[None]


MSSSIM = Family(
    "ms-ssim",
    "MS-SSIM",
    msssim,
    higher_is_better=True,
    decimals=4,
    terms=("border:left-out", "window:gauss11/1.5", "scales:5", "range:1"),
    perfect=1.0,
    regions=("box", "full"),
    least=LEAST,
)
