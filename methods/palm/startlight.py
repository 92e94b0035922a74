"""Where a fitted light starts: the powers of its lobes that explain a picture best, all at once."""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy.optimize import nnls
from torch import Tensor

from handbench.light.gaussians import SphericalGaussians, lobes

from .directions import strata
from .reflectance import Form, coloured, responses, seen_through
from .scattering import Scattering
from .visibility import Occluder

_DIRECTIONS = 512
_HELD = 0.05
"""Weight of the light that was there before, beside the picture's: lobes that light nothing seen stay as they were."""


@torch.no_grad()
def transfer(places: Scattering, light: SphericalGaussians, occluder: Occluder, form: Form) -> Tensor:
    """What each lobe at an amplitude of one adds to the colours of rays, (R, G, 3)."""
    towards = torch.from_numpy(strata(_DIRECTIONS)[0]).float()
    seen = occluder.of_all(places.point, places.normal, towards)
    answers = seen_through(responses(places.normal, places.view, places.material.roughness, towards, form), seen)
    basis = lobes(light.axes, light.sharpness, towards) * (4.0 * math.pi / _DIRECTIONS)
    of_lobes = [places.total(coloured(places.material, answers, b[:, None].expand(-1, 3))) for b in basis.T]
    return torch.stack(of_lobes, dim=1)


def solved(known: Tensor, image: Tensor, before: Tensor) -> Tensor:
    """Amplitudes (G, 3), none negative, of the lobes whose `transfer` (R, G, 3) comes closest to colours (R, 3).

    Least squares of each channel, with those `before` (G, 3), made as bright as the picture, held by `_HELD`.
    """
    system, wanted, old = (values.double().numpy() for values in (known, image, before))
    drawn = np.einsum("rgc,gc->rc", system, old)
    scaled = old * (wanted.sum() / max(float(drawn.sum()), 1e-12))
    answer = np.empty_like(old)
    for c in range(3):
        hold = math.sqrt(_HELD * float(np.square(system[..., c]).sum()) / len(old))
        rows = np.concatenate([system[..., c], hold * np.eye(len(old))])
        answer[:, c] = nnls(rows, np.concatenate([wanted[:, c], hold * scaled[:, c]]))[0]
    return torch.from_numpy(answer).to(before)


def as_bright(known: Tensor, image: Tensor, before: Tensor) -> Tensor:
    """The amplitudes `before` (G, 3), times what makes them as bright as the colours (R, 3) in all."""
    return before * (image.sum() / torch.einsum("rgc,gc->rc", known, before).sum().clamp_min(1e-12))
