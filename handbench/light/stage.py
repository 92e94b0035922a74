"""Light-stage layouts."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from ..scene import Array


def stage_directions(count: int) -> Array:
    """`count` unit directions (count, 3), well spread over the sphere: a golden spiral from +y down to -y."""
    if count < 1:
        raise InputError(f"a light stage of {count} lights is none; ask for at least 1")
    index = np.arange(count)
    up = 1.0 - (2.0 * index + 1.0) / count
    phi = index * np.pi * (3.0 - np.sqrt(5.0))
    ring = np.sqrt(1.0 - up * up)
    return np.stack([ring * np.sin(phi), up, ring * np.cos(phi)], axis=-1)
