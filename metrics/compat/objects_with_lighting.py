"""`objects-with-lighting`: what the evaluator of Objects With Lighting computes for linear predictions.

Read in isl-org/objects-with-lighting (commit 06f6076): `scripts/evaluate.py` (`scale_and_tonemap_prediction_image`),
`utils/metrics.py`, `utils/hdri.py` (`apply_exposure_and_gamma`), `utils/constants.py` (gamma 2.2).

Truth       8 bit, gamma 2.2 (not sRGB). Here: the linear truth at exposure 0.
Fit         an exposure, then a factor in [0.5, 2] for each channel, that make the mean absolute difference of the
            encoded pictures smallest, over the pixels of the mask where the truth is below 1. SciPy's
            `minimize_scalar` and `minimize` are called as there: what is passed as bounds of the exposure is a bracket
            to it, and so no bound; the factors are float32, so the last digits are those of the SciPy that runs.
PSNR        over the mask, range 1.
SSIM        scikit-image, 7 x 7 uniform windows, range 1, pictures times mask; the map is averaged over the mask.
LPIPS       Alex; in [-1, 1] first and masked then, so the background is grey; the map is averaged over the mask.

Under NumPy 2 the official program stops at its first linear prediction: the exposure is a float64, which makes the
picture float64, and `utils/metrics.py` asserts float32. Here the picture is made float32 after the fit.

Not reproduced: NaN and infinity, which become 0 there and a missing score here, and resizing of predictions of
another size. Predictions as PNG are not fitted there; here every prediction is linear and fitted.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from skimage.metrics import structural_similarity

from handbench.errors import Unsupported

from ..pair import Pair
from .shared import CAPPED, decibel, eight_bit, family, lpips_family, lpips_map, per_pair, psnr_family, some

_NAME = "objects-with-lighting"
_GAMMA = 2.2
_BALANCE = (0.5, 2.0)
_WINDOW = 7
_TERMS = (
    "region:mask",
    "mask:alpha>0.5",
    f"space:gamma{_GAMMA}",
    "truth:8bit",
    "exposure:search",
    f"balance:{_BALANCE[0]:g}-{_BALANCE[1]:g}",
)


class _Fitted(NamedTuple):
    prediction: NDArray[np.float32]
    truth: NDArray[np.float32]
    hand: NDArray[np.bool_]


def _encoded(linear: NDArray[Any], exposure: float = 0.0, balance: NDArray[Any] | float = 1.0) -> NDArray[Any]:
    """Linear values times `balance` at 2**exposure, gamma encoded, in [0, 1]; what overflows float32 is white."""
    with np.errstate(over="ignore"):
        return np.clip(np.power(np.clip(linear * balance * 2**exposure, 0.0, None), 1.0 / _GAMMA), 0.0, 1.0)


@per_pair
def _fitted(pair: Pair) -> _Fitted:
    """The prediction at the best exposure and colour balance, encoded, the truth, and the mask."""
    hand = some(pair.mask > 0.5, "with alpha > 0.5")
    truth = eight_bit(_encoded(pair.truth.astype(np.float64))).astype(np.float32)
    prediction = pair.prediction.astype(np.float32)
    counted = some(hand & (truth.max(axis=-1) < 1), "of the hand is below 1 in the truth")
    inside, wanted = prediction[counted], truth[counted]

    darkest = inside.min(axis=-1)
    if not (darkest > 0).any():
        raise Unsupported("the prediction has no pixel above 0 in all channels, so no exposure can be searched")
    greatest = np.log2(0.95**_GAMMA / darkest[darkest > 0].min())
    try:
        exposure = minimize_scalar(lambda x: np.abs(_encoded(inside, x) - wanted).mean(), (-10, greatest)).x
    except RuntimeError as error:  # scipy.optimize has no public name for its BracketError
        raise Unsupported(f"the search for an exposure found none ({error})") from error

    balance = minimize(
        lambda x: np.abs(_encoded(inside, exposure, x[None, :]) - wanted).mean(),
        np.ones(3, np.float32),
        bounds=3 * [_BALANCE],
    ).x.astype(np.float32)
    return _Fitted(_encoded(prediction, exposure, balance).astype(np.float32), truth, hand)


def psnr(pair: Pair) -> float:
    """PSNR in dB over the mask, after the fit."""
    prediction, truth, hand = _fitted(pair)
    return decibel(float(np.mean((prediction[hand].astype(np.float64) - truth[hand]) ** 2)))


def ssim(pair: Pair) -> float:
    """SSIM of the masked pictures, averaged over the mask and the channels."""
    prediction, truth, hand = _fitted(pair)
    if min(hand.shape) < _WINDOW:
        raise Unsupported(f"picture is smaller than the {_WINDOW}x{_WINDOW} pixels the metric needs")
    masked = (prediction * hand[..., None], truth * hand[..., None])
    _, similarity = structural_similarity(*masked, win_size=_WINDOW, channel_axis=-1, data_range=1.0, full=True)
    return float(similarity[hand].mean(dtype=np.float64))


def perceptual(pair: Pair) -> float:
    """LPIPS (Alex) of the pictures over grey, averaged over the mask."""
    prediction, truth, hand = _fitted(pair)
    over_grey = ((2.0 * image - 1.0) * hand[..., None] for image in (prediction, truth))
    return float(lpips_map("alex", *over_grey)[hand].mean(dtype=np.float64))


PSNR = psnr_family(_NAME, psnr, terms=(*_TERMS, "peak:1", CAPPED))
SSIM = family(
    _NAME,
    ssim,
    "SSIM",
    (*_TERMS, "background:black", f"window:uniform{_WINDOW}", "covariance:sample", "border:mirrored", "range:1"),
)
LPIPS = lpips_family(_NAME, perceptual, terms=(*_TERMS, "background:grey", "net:alex", "heads:0.1", "map:spatial"))
