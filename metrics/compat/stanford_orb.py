"""`stanford-orb`: image similarity as Stanford-ORB's evaluator computes it for novel views and relighting.

Read in StanfordORB/Stanford-ORB: `orb/utils/test.py` (`compute_similarity`, commit 1fe21c1), `orb/utils/metrics.py`
(`calc_PSNR`, commit 6595814), `orb/utils/preprocess.py` (sRGB curve).

Mask        alpha > 0.5, eroded by 5 x 5 pixels; both pictures are black outside it, and errors are averaged over the
            *whole* picture.
Scale       each channel of the linear prediction is fitted to the truth by least squares inside the mask: what is
            wrong in exposure or colour of light costs nothing. A single negative value inside the mask stops the
            official code in a debugger: there is no value then.
PSNR-H      linear, first brightened by the factor that makes the truth's mean that of its sRGB picture, clipped at 4;
            the peak is 1 nevertheless.
PSNR-L      clipped at 1, sRGB. Both are at least the PSNR of a uniform 0.5 inside the mask: a black prediction scores
            as a grey one.
SSIM        of the sRGB pictures, kornia with 3 x 3 windows.
LPIPS       VGG, of pictures that get the sRGB curve a second time: `lpips` encodes what `calc_PSNR` has encoded.

Not reproduced: the reduction of 2048 x 2048 pictures to 512 x 512 (scores are of the pictures as they are), and the
white picture that stands in for a missing one.
"""

from __future__ import annotations

import numpy as np
import torch
from kornia.losses import ssim_loss
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from handbench.errors import Unsupported
from handbench.scene.colour import srgb

from ..pair import Pair
from .shared import CAPPED, decibel, family, lpips, lpips_family, per_pair, psnr_family, some

_NAME = "stanford-orb"
_EROSION = 5
_WINDOW = 3
_TERMS = (
    "region:full",
    "mask:alpha>0.5",
    f"eroded:{_EROSION}x{_EROSION}",
    "background:black",
    "scale:rgb",
    "negative:none",
)
_FLOOR = "at-least:uniform-0.5"
_HDR_PEAK = 4.0


def _hand(pair: Pair) -> NDArray[np.bool_]:
    """The eroded mask; the border of the picture does not erode, as in OpenCV."""
    eroded = binary_erosion(pair.mask > 0.5, np.ones((_EROSION, _EROSION)), border_value=1)
    return some(eroded, f"is left after erosion by {_EROSION}x{_EROSION}")


def _fitted(
    prediction: NDArray[np.float64], truth: NDArray[np.float64], hand: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """The prediction with each channel scaled; a black channel gets the truth's mean as its factor, and stays black."""
    inside, wanted = prediction[hand], truth[hand]
    inside = np.where((inside**2).sum(axis=0) <= 1e-6, 1.0, inside)
    return prediction * ((wanted * inside).sum(axis=0) / (inside**2).sum(axis=0))


def _masked(pair: Pair) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    hand = _hand(pair)
    prediction = pair.prediction.astype(np.float64) * hand[..., None]
    negative = int(np.count_nonzero(prediction < 0.0))
    if negative:
        values = "value" if negative == 1 else "values"
        raise Unsupported(
            f"the prediction has {negative} negative {values} in the eroded mask: the official code stops"
        )
    return prediction, np.maximum(pair.truth.astype(np.float64), 0.0) * hand[..., None], hand


def _psnr(prediction: NDArray[np.float64], truth: NDArray[np.float64], hand: NDArray[np.bool_]) -> float:
    grey = 0.5 * hand[..., None]
    return max(decibel(float(np.mean((picture - truth) ** 2))) for picture in (prediction, grey))


def psnr_hdr(pair: Pair) -> float:
    """PSNR in dB of the brightened linear pictures, clipped at 4, over all pixels."""
    prediction, truth, hand = _masked(pair)
    mean = np.clip(truth, 0.0, 1.0).mean()
    gain = srgb(truth).mean() / mean if mean > 1e-8 else 1.0
    fitted = _fitted(gain * prediction, gain * truth, hand)
    return _psnr(np.clip(fitted, 0.0, _HDR_PEAK), np.clip(gain * truth, 0.0, _HDR_PEAK), hand)


@per_pair
def _low(pair: Pair) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """The fitted prediction and the truth, sRGB encoded, and the mask."""
    prediction, truth, hand = _masked(pair)
    return srgb(_fitted(prediction, truth, hand)), srgb(truth), hand


def psnr_ldr(pair: Pair) -> float:
    """PSNR in dB of the sRGB pictures over all pixels."""
    return _psnr(*_low(pair))


def ssim(pair: Pair) -> float:
    """1 - 2 x kornia's structural dissimilarity of the sRGB pictures."""
    if min(pair.mask.shape) < _WINDOW - 1:  # kornia reflects the border
        raise Unsupported(f"picture is smaller than the {_WINDOW - 1}x{_WINDOW - 1} pixels the metric needs")
    prediction, truth, _ = (torch.from_numpy(np.moveaxis(np.atleast_3d(a), 2, 0))[None] for a in _low(pair))
    return 1.0 - 2.0 * float(ssim_loss(prediction, truth, _WINDOW))


def perceptual(pair: Pair) -> float:
    """LPIPS (VGG) of the pictures, encoded a second time."""
    prediction, truth, _ = _low(pair)
    return lpips("vgg", 2.0 * srgb(prediction) - 1.0, 2.0 * srgb(truth) - 1.0)


PSNR_HDR = psnr_family(
    _NAME,
    psnr_hdr,
    name="psnr-hdr",
    quantity="PSNR-H",
    terms=(*_TERMS, "space:linear", "gain:truth-to-srgb-mean", "clip:0-4", "peak:1", _FLOOR, CAPPED),
    perfect=100.0,
    version=2,
)
PSNR_LDR = psnr_family(
    _NAME,
    psnr_ldr,
    name="psnr-ldr",
    quantity="PSNR-L",
    terms=(*_TERMS, "space:srgb", "peak:1", _FLOOR, CAPPED),
    perfect=100.0,
    version=2,
)
# kornia adds 1e-12 to a denominator of 9e-8 on black, so even equal pictures score 1e-5 less than 1
SSIM = family(
    _NAME, ssim, "SSIM", (*_TERMS, "space:srgb", "window:gauss3/1.5", "padding:reflect", "range:1"), version=2
)
LPIPS = lpips_family(
    _NAME, perceptual, terms=(*_TERMS, "space:srgb-twice", "net:vgg", "heads:0.1"), perfect=0.0, version=2
)
