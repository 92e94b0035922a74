"""`goliath`: the PSNR and SSIM of the released code of Goliath, URHand and RelightableHands.

Read in facebookresearch/goliath: `ca_code/loss/__init__.py` (`psnr`, `rgb_ssim`; commit 053c42a),
`ca_code/utils/ssim.py` (948c715), `ca_code/scripts/run_test.py` (which asks for PSNR, range 255 for hands; 249e280),
`ca_code/utils/test.py` (8c2f91e) and `ca_code/utils/dataloader.py` (pictures of hands: black level, white balance,
clamped to 0–255, linear; mask: segmentation other than 0; 249e280).

Range   the truth is clamped, the prediction is not (`clip=truth`): where a highlight is brighter than white, a right
        prediction pays. `clip=both` clamps the prediction too.
PSNR    the difference is multiplied by the mask and its square averaged over the *whole* picture: the smaller the
        hand, the better. 10 log10(1 / 0.15) = 8.2 dB for a hand that covers 15 % of the picture.
SSIM    11 x 11 Gaussian windows, sigma 1.5, padded with zeros; the pictures are not masked, the map is averaged over
        the mask; constants are those of range 1. The test script does not ask for it for hands: it is a training loss
        of the head model (`config/rgca_example.yml`), whose pictures are in [0, 1], as they are here.

Not reproduced: pixels at depth discontinuities of the *predicted* mesh, which `psnr` leaves out where a model tells
them. Not reproduced either: there is no mean over pictures. `test` writes each one's value over the last, into the log.
Not published: which of these, if any, made the tables of URHand.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from ..pair import Pair
from .shared import CAPPED, decibel, family, psnr_family, some, ssim_map

_NAME = "goliath"
_CHOICES = {"clip": ("truth", "both")}
_TERMS = ("clipped-to:0-255", "mask:alpha>0", "space:linear")


def _pictures(pair: Pair, clip: str) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Prediction and truth, linear, in [0, 1] where they are clipped, and the mask."""
    prediction, truth = pair.prediction.astype(np.float64), np.clip(pair.truth.astype(np.float64), 0.0, 1.0)
    prediction = np.clip(prediction, 0.0, 1.0) if clip == "both" else prediction
    return prediction, truth, some(pair.mask > 0, "with alpha > 0")


def psnr(pair: Pair, clip: str) -> float:
    """PSNR in dB of the masked difference over all pixels, peak 255."""
    prediction, truth, mask = _pictures(pair, clip)
    return decibel(float(np.mean((255.0 * (prediction - truth) * mask[..., None]) ** 2)), peak=255.0)


def ssim(pair: Pair, clip: str) -> float:
    """SSIM of the unmasked pictures, averaged over the mask and the channels."""
    prediction, truth, mask = _pictures(pair, clip)
    blur = partial(gaussian_filter, sigma=1.5, radius=5, mode="constant", axes=(0, 1))
    return float(ssim_map(prediction, truth, blur)[mask].mean())


# no value is perfect for every truth: a truth above 1 is clipped, and the prediction that equals it is not
PSNR = psnr_family(
    _NAME,
    psnr,
    terms=("region:full", *_TERMS, "masked:difference", "peak:255", CAPPED),
    choices=_CHOICES,
    version=2,
)
SSIM = family(
    _NAME,
    ssim,
    "SSIM",
    ("region:mask", *_TERMS, "window:gauss11/1.5", "padding:zero", "range:1"),
    choices=_CHOICES,
    version=2,
)
