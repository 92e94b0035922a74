"""How far light wanders under the skin: mean free paths from pigments, blood and what lies beneath."""

from __future__ import annotations

import numpy as np

from ...scene import Array

# Jensen et al., "A Practical Model for Subsurface Light Transport" (2001), skin 1: per metre, red, green, blue.
SCATTERING = np.array([740.0, 880.0, 1010.0], np.float32)
ABSORPTION = np.array([32.0, 170.0, 480.0], np.float32)
# Under a nail light meets a thin plate and the bed: metres.
NAIL_PATH = np.array([1.6e-3, 0.8e-3, 0.5e-3], np.float32)
# Jensen's subject in the units of `skin.py`: melanin on the back of the hand, haemoglobin of a fair person.
_MELANIN, _HAEMOGLOBIN = 0.4, 0.4
# Share of Jensen's absorption that is blood (it absorbs green and blue), and what one unit of melanin adds per metre.
_BLOOD = np.array([0.35, 0.6, 0.5], np.float32)
_PIGMENT = np.array([12.0, 30.0, 60.0], np.float32)


def mean_free_path(melanin: Array, haemoglobin: Array) -> Array:
    """Diffuse mean free path (N, 3) in metres of skin with melanin (N,) and haemoglobin (N,), red, green, blue.

    1 / sqrt(3 a (a + s)) with reduced scattering s and absorption a; fair skin has about 3.7, 1.4, 0.7 mm and very
    dark skin a little over half. What pigments add is chosen, not measured.
    """
    blood = 1 - _BLOOD + _BLOOD * (haemoglobin / _HAEMOGLOBIN)[:, None]
    absorption = ABSORPTION * blood + _PIGMENT * (melanin - _MELANIN)[:, None]
    absorption = np.maximum(absorption, 0.5 * ABSORPTION)
    return 1 / np.sqrt(3 * absorption * (absorption + SCATTERING))
