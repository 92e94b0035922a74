"""`palm-official`: what the released evaluator of PALM-Net computes on InterHand2.6M.

Read in facebookresearch/PALM (commit 2d834f4): `code/eval_seen_env.py` prepares the pictures,
`code/systems/criterions.py` has the metrics, `code/requirements.txt` (1afc032) pins scikit-image 0.18.1.

Pictures    8 bit sRGB; the hand is where the mask is 255; the truth is white elsewhere. The prediction is rendered
            over white and keeps what it has there.
            Its renderer (`code/utils/mixins.py`) truncates to 8 bits when it saves a picture, which darkens it by half
            a code on average; `codes=truncated` does so, `codes=rounded` is what a careful renderer saves.
PSNR        over the hand's pixels, peak 1.
SSIM        scikit-image with 7 x 7 uniform windows in the bounding box of the hand. No data range is given, and
            the pinned version takes floats to span [-1, 1]: 2, so that both constants are four times as large.
LPIPS       VGG in the same box, fed 2(2x - 1) - 1: the caller normalises, and `normalize=True` does it again.

The pictures are flattened for PSNR and then reshaped with PIL's `size`, which is (width, height), taken for (height,
width). A picture that is not square is thereby wrapped into rows of another length before SSIM and LPIPS see it;
InterHand2.6M is 334 pixels wide and 512 high, so this concerns every published number. It is done here too.

Where the mask is not 255, at the soft edge of a hand as well, the truth is white and a perfect rendering is not: it
scores less than 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

from handbench.errors import Unsupported

from ..pair import Pair
from .shared import (
    CAPPED,
    COVERAGE,
    decibel,
    display,
    eight_bit,
    family,
    lpips,
    lpips_family,
    own_alpha,
    psnr_family,
    some,
)

_NAME = "palm-official"
_CHOICES = {"codes": ("rounded", "truncated")}
_PICTURES = ("mask:alpha=255", "space:srgb8", "background:white", COVERAGE)
_BOX = ("region:box-of-mask", "rows:wrapped-at-height", *_PICTURES)
_WINDOW = 7


class _Pictures(NamedTuple):
    prediction: NDArray[np.float64]
    truth: NDArray[np.float64]
    hand: NDArray[np.bool_]


def _pictures(pair: Pair, codes: str) -> _Pictures:
    hand = some(np.round(np.clip(pair.mask, 0.0, 1.0) * 255.0) == 255, "has alpha 255 of 255")
    truth = eight_bit(display(pair.truth))
    truth[~hand] = 1.0
    prediction = display(pair.prediction, own_alpha(pair))
    return _Pictures(_truncated(prediction) if codes == "truncated" else eight_bit(prediction), truth, hand)


def _truncated(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values in [0, 1] at the code below; what is a code, but for the rounding of single precision, stays one."""
    return np.floor(image * 255.0 + 1e-3) / 255.0


def _box(pair: Pair, codes: str, least: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Prediction and truth in the bounding box of the hand, after the official reshape."""
    height, width = pair.mask.shape
    found = _pictures(pair, codes)
    prediction, truth = (image.reshape(width, height, 3) for image in (found.prediction, found.truth))
    hand = found.hand.reshape(width, height)
    rows, columns = (np.flatnonzero(hand.any(axis=axis)) for axis in (1, 0))
    cut = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    if min(prediction[cut].shape[:2]) < least:
        raise Unsupported(f"the mask's bounding box is smaller than the {least}x{least} pixels the metric needs")
    return prediction[cut], truth[cut]


def psnr(pair: Pair, codes: str) -> float:
    """PSNR in dB over the pixels of the hand."""
    prediction, truth, hand = _pictures(pair, codes)
    return decibel(float(np.mean((prediction - truth)[hand] ** 2)))


def ssim(pair: Pair, codes: str) -> float:
    """SSIM with data range 2 in the box."""
    pictures = _box(pair, codes, _WINDOW)
    return float(structural_similarity(*pictures, win_size=_WINDOW, channel_axis=-1, data_range=2.0))


def perceptual(pair: Pair, codes: str) -> float:
    """LPIPS (VGG), normalised twice, in the box."""
    prediction, truth = (4.0 * image - 3.0 for image in _box(pair, codes, 1))
    return lpips("vgg", prediction, truth)


# truncated, even the truth is not perfect
PSNR = psnr_family(_NAME, psnr, terms=("region:mask", *_PICTURES, "peak:1", CAPPED), choices=_CHOICES)
SSIM = family(
    _NAME,
    ssim,
    "SSIM",
    (*_BOX, f"window:uniform{_WINDOW}", "covariance:sample", "border:left-out", "range:2"),
    choices=_CHOICES,
)
LPIPS = lpips_family(_NAME, perceptual, terms=(*_BOX, "net:vgg", "heads:0.1", "normalised:twice"), choices=_CHOICES)
