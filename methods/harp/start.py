"""Where the light of a fit begins, if not where the authors' begins: where brightness grows along the normals."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from handbench.evenly import evenly
from handbench.scene import Array

_MOST = 4000  # normals that are looked at


def lit_from(normal: Array, brightness: Array) -> tuple[float, Array]:
    """The ambient share and the direction (3,) of a light that explain the brightness (N,) of normals (N, 3) best:
    A (a + (1 - a) max(0, n.l)) with a robust norm, the share within 0.1 to 0.9."""
    some = evenly(range(len(normal)), _MOST)
    normal, brightness = normal[some].astype(np.float64), brightness[some].astype(np.float64)
    scale = max(float(brightness.mean()), 1e-9)
    flat = np.linalg.lstsq(np.c_[np.ones(len(normal)), normal], brightness / scale, rcond=None)[0]

    def off(x: Array) -> Array:
        return x[0] + np.maximum(normal @ x[1:], 0.0) - brightness / scale

    x = least_squares(off, [0.5, *flat[1:]], loss="soft_l1", f_scale=0.5).x
    power = float(np.linalg.norm(x[1:]))
    if power < 1e-6:
        return 0.9, np.array([0.0, 1.0, 0.0])
    return float(np.clip(x[0] / (abs(x[0]) + power), 0.1, 0.9)), x[1:] / power
