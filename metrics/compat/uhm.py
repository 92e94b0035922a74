"""`uhm`: what the released evaluator of UHM computes.

Read in facebookresearch/UHM (commit 163be36): `Avatar/main/eval.py`, `Avatar/main/config.py` (512 x 512),
`Avatar/data/HARP/HARP.py` (mask > 0.5; the whole 448 x 448 picture is enlarged), `Avatar/main/model.py` (black
background). `Avatar/main/requirements.txt` names torchmetrics without a version.

Pictures    sRGB in [0, 1], both multiplied by prediction mask x truth mask: what a prediction misses of the hand, or
            draws beside it, costs nothing here, only in the IoU.
PSNR, SSIM  torchmetrics, data range 1, over the whole picture; 11 x 11 Gaussian windows. Up to its version 1.4.1, as
            when the paper was written, torchmetrics left out a border of 5 pixels; since 1.4.2 (September 2024) it
            counts it, as windows see it that are mirrored there. `torchmetrics` chooses.
LPIPS       Alex; pictures are mapped to [-1, 1] first and masked then, so the background is grey, not black.
IoU         of the two masks, in per cent.

A prediction that misses the hand leaves nothing to compare: two black pictures, a perfect score there. Here there is no
value then.

Not reproduced: the enlargement to 512 x 512 (scores are of the pictures as they are) and the depth error.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from handbench.errors import Unsupported

from ..pair import Pair
from .shared import (
    CAPPED,
    COVERAGE,
    decibel,
    display,
    family,
    lpips,
    lpips_family,
    own_alpha,
    psnr_family,
    some,
    ssim_map,
)

_NAME = "uhm"
_WINDOW = 11
_TERMS = ("region:full", "mask:prediction>0.5-and-truth>0.5", COVERAGE, "space:srgb")


def _pictures(pair: Pair) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Prediction and truth, unmasked, and the mask (H, W, 1) of both."""
    truth = some(pair.mask > 0.5, "with alpha > 0.5")
    both = some(
        truth & (own_alpha(pair) > 0.5),
        "that prediction and truth both cover: the prediction misses the hand, which the official code calls perfect",
    )
    return display(pair.prediction), display(pair.truth), both[..., None]


def psnr(pair: Pair) -> float:
    """PSNR in dB of the masked pictures over all pixels."""
    prediction, truth, mask = _pictures(pair)
    return decibel(float(np.mean((prediction * mask - truth * mask) ** 2)))


def ssim(pair: Pair, torchmetrics: str) -> float:
    """Mean SSIM of the masked pictures: away from the border up to version 1.4.1 of torchmetrics."""
    prediction, truth, mask = _pictures(pair)
    if min(mask.shape[:2]) < _WINDOW:
        raise Unsupported(f"picture is smaller than the {_WINDOW}x{_WINDOW} pixels the metric needs")
    border = _WINDOW // 2
    blur = partial(gaussian_filter, sigma=1.5, radius=border, mode="mirror", axes=(0, 1))
    found = ssim_map(prediction * mask, truth * mask, blur)
    return float((found[border:-border, border:-border] if torchmetrics == "1.4.1" else found).mean())


def perceptual(pair: Pair) -> float:
    """LPIPS (Alex) of the pictures over grey."""
    prediction, truth, mask = _pictures(pair)
    return lpips("alex", (2.0 * prediction - 1.0) * mask, (2.0 * truth - 1.0) * mask)


def iou(pair: Pair) -> float:
    """Intersection over union of the masks, in per cent."""
    prediction, truth = own_alpha(pair) > 0.5, pair.mask > 0.5
    union = some(prediction | truth, "that prediction or truth covers")
    return 100.0 * float((prediction & truth).sum() / union.sum())


PSNR = psnr_family(_NAME, psnr, terms=(*_TERMS, "background:black", "peak:1", CAPPED), perfect=100.0)
SSIM = family(
    _NAME,
    ssim,
    "SSIM",
    (*_TERMS, "background:black", "window:gauss11/1.5", "range:1"),
    choices={"torchmetrics": ("1.4.1", "1.4.2")},
    perfect=1.0,
)
LPIPS = lpips_family(_NAME, perceptual, terms=(*_TERMS, "background:grey", "net:alex", "heads:0.1"), perfect=0.0)
IOU = family(
    _NAME,
    iou,
    "Mask IoU",
    ("mask:alpha>0.5",),
    name="iou",
    needs=("prediction", "prediction_alpha"),
    perfect=100.0,
    unit="%",
    decimals=2,
)
