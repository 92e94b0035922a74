"""Texels that a network looks at and a picture does not: few are shaded, for those around them too."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import binary_dilation
from torch import Tensor

from handbench.render.see.raster import Raster
from handbench.render.uv.atlas import Atlas
from handbench.scene import Array

_AROUND = 4
"""Texels around those that are looked up which are shaded too: the finest layers of a network mix them in."""


@dataclass(frozen=True)
class Sampling:
    """Which of an atlas's N covered texels are shaded, texels (n,), and whose light each takes, source (N,) in n."""

    texels: Array
    source: Tensor

    @staticmethod
    def of(atlas: Atlas, raster: Raster) -> Sampling:
        """Those that the raster looks up and those next to them are shaded, and of the others every fourth one both
        ways, whose light the rest takes (`Atlas.nearest_fourth`)."""
        size, own = atlas.size, np.arange(atlas.count)
        shown = np.zeros((size, size), dtype=bool)
        shown.ravel()[atlas.texels[atlas.needed(raster.texels(size))]] = True
        near = binary_dilation(shown, np.ones((3, 3)), iterations=_AROUND)
        traced = near.ravel()[atlas.texels] | (atlas.nearest_fourth == own)
        place = np.cumsum(traced) - 1
        return Sampling(np.flatnonzero(traced), torch.from_numpy(place[np.where(traced, own, atlas.nearest_fourth)]))
