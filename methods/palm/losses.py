"""The terms of PALM-Net's loss (the seed's Sec. 5), not yet weighted."""

from __future__ import annotations

import torch
from torch import Tensor

from handbench.scene.colour import unclipped_srgb

from ..kit.perceptual import perceptual_loss
from .frames import Rays
from .posed import PosedHand, Rendering

_CERTAIN = 1e-3  # a pixel that should be covered costs no more than its logarithm
_TANGENT = 5e-4  # metres between normals that curvature compares: a fraction of a cell of the encodings


def colours(drawn: Tensor, alpha: Tensor, rays: Rays, background: Tensor) -> tuple[Tensor, Tensor]:
    """Display values (R, 3) of premultiplied colours over a background (3,), drawn and true."""
    made = drawn + (1.0 - alpha[:, None]) * background
    true = rays.image + (1.0 - rays.alpha[:, None]) * background
    return unclipped_srgb(made), unclipped_srgb(true)


def patches(shown: tuple[Tensor, Tensor], side: int) -> Tensor:
    """The perceptual distance of the patches that end drawn and true values (R, 3)."""
    made, true = (values[-side * side :].T.view(3, side, side) for values in shown)
    return perceptual_loss(made[None], true)[0]


def mask(alpha: Tensor, rays: Rays) -> Tensor:
    """Binary cross entropy of coverage."""
    return cross_entropy(alpha, rays.alpha, _CERTAIN)


def cross_entropy(alpha: Tensor, wanted: Tensor, least: float) -> Tensor:
    """Binary cross entropy of coverage (R,), no closer to 0 and 1 than `least`.

    torch's own refuses NaN with words of its own; here it goes on to who names step and term.
    """
    sure = alpha.clamp(least, 1.0 - least)
    return -(wanted * sure.log() + (1.0 - wanted) * (1.0 - sure).log()).mean()


def normals(rendering: Rendering, rays: Rays) -> Tensor:
    """Mean absolute difference of normals where the hand covers the pixel (code; the seed squares it)."""
    assert rays.normal is not None
    covered = rays.alpha > 0.99
    if not covered.any():
        return rendering.weight.sum() * 0.0
    seen = rendering.total(rendering.normal)[covered]
    return (seen - rays.normal[covered]).abs().sum(dim=1).mean()


def eikonal(gradient: Tensor) -> Tensor:
    """How far the gradients (N, 3) of the signed distance are from unit length, squared."""
    return (gradient.norm(dim=1) - 1.0).square().mean()


def curvature(posed: PosedHand, rendering: Rendering, tangent: Tensor) -> Tensor:
    """Angle over pi between normals at samples and beside them, `tangent` (P, 3) a random direction (released code)."""
    normal = torch.nn.functional.normalize(rendering.gradient, dim=1, eps=1e-9)
    across = torch.nn.functional.normalize(torch.linalg.cross(normal.detach(), tangent), dim=1, eps=1e-9)
    beside = posed.model.geometry(rendering.x.detach() + _TANGENT * across, posed.conditions, gradient=True).gradient
    assert beside is not None
    cosine = (normal * torch.nn.functional.normalize(beside, dim=1, eps=1e-9)).sum(dim=1)
    return cosine.clamp(-1.0 + 1e-6, 1.0 - 1e-6).acos().mean() / torch.pi
