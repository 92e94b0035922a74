"""`harp`: what HARP's evaluator computes.

Read in korrawe/harp: `utils/eval_util.py` (`image_eval`, commit 8259bca), `optimize_sequence.py` (what is given to it,
commit 74902b1), `renderer/renderer_helper.py` (white background), `utils/data_util.py`. There is no PSNR.

Pictures    sRGB in [0, 1] over white, whole. A comment says that only what the predicted hand covers is compared; the
            line that would do so is commented out.
L1          mean absolute difference of all pixels, on the scale of [0, 1].
LPIPS       Alex, fed [0, 1] where [-1, 1] is expected: half of the contrast, around light grey.
MS-SSIM     pytorch-msssim, range 1: five scales, so pictures must be wider and higher than 160 pixels.
IoU         of the masks at 0.5, in [0, 1].

Not reproduced: batches of 64 pictures are averaged first and then their means, so that pictures of the last batch weigh
more; here every picture counts the same. Predictions are not clipped there; here display encoding ends at 1.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from pytorch_msssim import ms_ssim as structure

from handbench.errors import Unsupported

from ..pair import Pair
from .shared import COVERAGE, display, family, lpips, lpips_family, own_alpha, some

_NAME = "harp"
_TERMS = ("region:full", "space:srgb", "background:white", COVERAGE)
_TOO_SMALL = 160  # a window of 11 pixels must fit into a sixteenth of the picture


def _pictures(pair: Pair) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return display(pair.prediction, own_alpha(pair)), display(pair.truth, pair.mask)


def l1(pair: Pair) -> float:
    """Mean absolute difference of all pixels and channels."""
    prediction, truth = _pictures(pair)
    return float(np.abs(prediction - truth).mean())


def perceptual(pair: Pair) -> float:
    """LPIPS (Alex) of pictures that were not normalised."""
    return lpips("alex", *_pictures(pair))


def iou(pair: Pair) -> float:
    """Intersection over union of the silhouettes, in [0, 1]."""
    prediction, truth = own_alpha(pair) >= 0.5, pair.mask >= 0.5
    union = some(prediction | truth, "that prediction or truth covers")
    return float((prediction & truth).sum() / union.sum())


def ms_ssim(pair: Pair) -> float:
    """MS-SSIM of all pixels, mean over channels."""
    images = [torch.from_numpy(np.moveaxis(image, 2, 0).copy())[None] for image in _pictures(pair)]
    if min(images[0].shape[2:]) <= _TOO_SMALL:
        raise Unsupported(f"picture is not wider and higher than {_TOO_SMALL} pixels, as five scales need")
    return float(structure(*images, data_range=1.0))


L1 = family(_NAME, l1, "L1", _TERMS, perfect=0.0, higher_is_better=False)
LPIPS = lpips_family(_NAME, perceptual, terms=(*_TERMS, "net:alex", "heads:0.1", "normalised:never"), perfect=0.0)
MS_SSIM = family(
    _NAME, ms_ssim, "MS-SSIM", (*_TERMS, "window:gauss11/1.5", "border:left-out", "scales:5", "range:1"), perfect=1.0
)
IOU = family(
    _NAME, iou, "Mask IoU", ("mask:alpha>=0.5",), name="iou", needs=("prediction", "prediction_alpha"), perfect=1.0
)
