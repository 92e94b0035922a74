"""FLIP (Andersson et al., HPG 2020) and HDR-FLIP (EG 2021), computed by flip-evaluator, NVIDIA's own code.

How different two pictures look when one flips between them at a viewing distance, in [0, 1]: FLIP of pictures as
displayed, HDR-FLIP of linear ones: *for each pixel* the greatest FLIP over exposures, tone mapped, and then the mean
over pixels. Beyond the picture the filters see its border repeated. Left to itself HDR-FLIP
chooses the exposures from the truth, so that each frame is measured by its own rule (and a frame that is mostly black
by a hundred exposures, which takes seconds): here they are fixed, and the signature names them. They go from where
radiance 16 is still below white to where the deep shadows of a hand are well visible.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from math import pi

import flip_evaluator
import numpy as np

from .base import Family
from .view import View

PIXELS_PER_DEGREE = 0.7 * 3840 / 0.7 * pi / 180  # FLIP's default: a 0.7 m wide screen of 3840 pixels, 0.7 m away
EXPOSURES = {"startExposure": -4.0, "stopExposure": 2.0, "numExposures": 4}
GREATEST = 65504.0  # of float16, as EXR files hold: brighter is cut off

_REACH = 10  # pixels that the widest filter reaches at this many pixels per degree


def flip(dynamic_range: str, parameters: Mapping[str, float | str], view: View) -> float:
    """Mean FLIP of the region, dynamic range "LDR" or "HDR"."""
    truth, prediction = (np.clip(image, 0.0, GREATEST).astype(np.float32) for image in (view.truth, view.prediction))
    errors, _, _ = flip_evaluator.evaluate(
        truth, prediction, dynamic_range, applyMagma=False, computeMeanError=False, parameters=dict(parameters)
    )
    return float(errors.reshape(view.support.shape)[view.support].mean(dtype=np.float64))


def _family(
    name: str, dynamic_range: str, space: str, parameters: Mapping[str, float | str], terms: tuple[str, ...]
) -> Family:
    return Family(
        name,
        name.upper(),
        partial(flip, dynamic_range, {"ppd": PIXELS_PER_DEGREE, **parameters}),
        higher_is_better=False,
        decimals=4,
        terms=(f"ppd:{PIXELS_PER_DEGREE:.2f}", *terms),
        perfect=0.0,
        spaces=(space,),
        context=_REACH,
        least=1,
    )


_CLIPPED = f"clip:0..{GREATEST:g}"
_EXPOSED = "exposures:{startExposure:g}..{stopExposure:g}/{numExposures}".format(**EXPOSURES)

FLIP = _family("flip", "LDR", "srgb", {}, ())
HDR_FLIP = _family("hdr-flip", "HDR", "linear", {**EXPOSURES, "tonemapper": "aces"}, (_EXPOSED, "tone:aces", _CLIPPED))
