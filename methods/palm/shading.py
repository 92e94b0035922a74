"""The physically based colour of rays: light that scatters at a few places along each.

    C(ray) = sum over i of w_i  f(d, v_i, a, r, m, n) cos  L(v_i) V / pdf(v_i)          (the seed, Sec. 4.2)

Light scatters where a ray is stopped: w_i are the volume's weights. The released code draws 512 places a ray by those
weights, and for each one direction out of 16 x 32 strata of the sphere; so does `physical`, with any number of them.
What the hand itself sends to a place is left out, as the released code does when it relights.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import torch
from torch import Tensor

from handbench.light.gaussians import SphericalGaussians

from .directions import strata
from .reflectance import Form, coloured, responses
from .scattering import Scattering

if TYPE_CHECKING:
    from .posed import PosedHand, Rendering

Visible: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""How much of the light from unit directions (N, 3) reaches points (N, 3), in [0, 1]: (N), without gradient."""


def physical(
    posed: PosedHand,
    rendering: Rendering,
    directions: Tensor,
    light: SphericalGaussians,
    visible: Visible | None,
    samples: int,
    rng: np.random.Generator,
    form: Form = "released",
) -> Tensor:
    """Linear colours (R, 3), premultiplied, of rays in unit directions (R, 3) that were marched through a posed hand.

    `samples` places and directions a ray; None sees everything. Differentiable in the light and in all that the
    rendering has a gradient in.
    """
    scattering = Scattering.of(posed, rendering, directions)
    return single_scattered(scattering.drawn(samples, rng), light, visible, samples, rng, form)


def single_scattered(
    places: Scattering,
    light: SphericalGaussians,
    visible: Visible | None,
    samples: int,
    rng: np.random.Generator,
    form: Form = "released",
) -> Tensor:
    """Colours (R, 3) of rays with `samples` places each (`Scattering.drawn`), of which each looks in one direction.

    A ray's directions are one in each stratum of the sphere, dealt out at random among its places.
    """
    sets = len(places.ray) // samples
    order = rng.permuted(np.tile(np.arange(samples), (sets, 1)), axis=1)
    towards = np.take_along_axis(strata(samples, rng, sets), order[..., None], axis=1)
    towards = torch.from_numpy(towards).to(places.point).reshape(-1, 3)
    seen = shadows(places, towards, visible)
    power = light.evaluate(towards) * (4.0 * math.pi * seen)[:, None]
    answers = responses(places.normal, places.view, places.material.roughness, towards[:, None], form)
    return places.total(coloured(places.material, answers, power[:, None]))


@torch.no_grad()
def shadows(places: Scattering, towards: Tensor, visible: Visible | None) -> Tensor:
    """How much places (N) see of one direction each, (N, 3); those below the horizon are not asked for."""
    above = (places.normal * towards).sum(1) > 1e-6
    if visible is None:
        return above.to(towards)
    seen = torch.zeros_like(towards[:, 0])
    seen[above] = visible(places.point[above], towards[above]).to(seen)
    return seen
