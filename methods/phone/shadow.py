"""Shadow as the difference in darkness from the mean colour, smooth over the texture, and divided out.

URHand supp. Sec. 3. The seed gives neither the weight nor the optimiser; with squared differences it is one sparse
linear system. What it cannot tell apart: a palm that is lighter than the back is to it a palm in brighter light, so it
bleaches dark skin and darkens what is lighter than the mean.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import torch
from scipy.sparse.linalg import spsolve

from handbench.render.uv.atlas import Atlas
from handbench.scene import Array

LEAST = 0.05  # of the mean colour: darker than that a shadow tells nothing of what is in it


def shadow(
    mean: Array, seen: Array, foreground: Array, atlas: Atlas, variation: float, most: float | None = None
) -> Array:
    """The shadow (N,) of a mean texture (3, N) of which `seen` (N,) texels count, as a factor of the colour (3,) of the
    foreground.

    Minimises the sum over texels of |S c - U|^2 / |c|^2 plus `variation` times the squared differences of neighbours
    in a chart. Not less than `LEAST`, nor more than `most`.
    """
    count = len(seen)
    ratio = (foreground @ mean) / (foreground @ foreground)
    right = [other.numpy() for other in atlas.neighbours(torch.device("cpu"))[::2]]  # each pair once
    first = np.concatenate([np.flatnonzero(other != np.arange(count)) for other in right])
    second = np.concatenate([other[other != np.arange(count)] for other in right])
    ones = np.ones(len(first))
    step = sp.csr_array(
        (np.r_[ones, -ones], (np.r_[: len(first), : len(first)], np.r_[first, second])), (len(first), count)
    )
    # a chart of which nothing was seen is held at the mean colour
    held = np.where(seen, 1.0, 1e-6)
    matrix = sp.diags_array(held) + variation * (step.T @ step)
    found = spsolve(matrix.tocsc(), held * np.where(seen, ratio, 1.0))
    return np.clip(found, LEAST, most)
