"""The physically based colour of rays: light that scatters at a few places along each.

    C(ray) = sum over i of w_i  f(d, v_i, a, r, m, n) cos  L(v_i) V / pdf(v_i)          (the seed, Sec. 4.2)

Light scatters where a ray is stopped: w_i are the volume's weights. The released code draws 512 places a ray by those
weights, and for each one direction out of 16 x 32 strata of the sphere (`dealt`). Short runs learn from less noise if
few places look in all directions (`shared`): L1 of a noisy colour is least at too dark a light.
What the hand itself sends to a place is left out, as the released code does when it relights.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from handbench.light.gaussians import SphericalGaussians

from .directions import strata
from .reflectance import Form, coloured, responses, seen_through
from .scattering import Scattering
from .visibility import Occluder

if TYPE_CHECKING:
    from .posed import PosedHand, Rendering


def physical(
    posed: PosedHand,
    rendering: Rendering,
    light: SphericalGaussians,
    occluder: Occluder | None,
    samples: int,
    rng: np.random.Generator,
    form: Form = "released",
    places: int | None = None,
) -> Tensor:
    """Linear colours (R, 3), premultiplied, of rays that were marched through a posed hand.

    `samples` directions a ray, each of a place of its own, or all of each of `places`. Without an occluder nothing is
    hidden. Differentiable in the light and in all that the rendering has a gradient in.
    """
    scattering = Scattering.of(posed, rendering)
    if places is None:
        return dealt(scattering.drawn(samples, rng), light, occluder, samples, rng, form)
    return shared(scattering.drawn(places, rng), light, occluder, samples, rng, form)


def dealt(
    places: Scattering,
    light: SphericalGaussians,
    occluder: Occluder | None,
    samples: int,
    rng: np.random.Generator,
    form: Form = "released",
) -> Tensor:
    """Colours (R, 3) of rays with `samples` places each (`Scattering.drawn`), of which each looks in one direction.

    A ray's directions are one in each stratum of the sphere, dealt out at random among its places.
    """
    sets = len(places.ray) // samples
    order = rng.permuted(np.tile(np.arange(samples), (sets, 1)), axis=1)
    chosen = np.take_along_axis(strata(samples, rng, sets), order[..., None], axis=1)
    towards = torch.from_numpy(chosen).to(places.point).reshape(-1, 3)
    above = (places.normal.detach() * towards).sum(dim=1) > 1e-6
    seen = above.to(towards)
    if occluder is not None:
        seen[above] = occluder(places.point[above], towards[above]).to(seen)
    power = light.evaluate(towards) * (4.0 * math.pi * seen)[:, None]
    answers = responses(places.normal, places.view, places.material.roughness, towards[:, None], form)
    return places.total(coloured(places.material, answers, power[:, None]))


def shared(
    places: Scattering,
    light: SphericalGaussians,
    occluder: Occluder | None,
    samples: int,
    rng: np.random.Generator,
    form: Form = "released",
) -> Tensor:
    """Colours (R, 3) of rays whose places all look in the same `samples` directions, one in each stratum."""
    towards = torch.from_numpy(strata(samples, rng)[0]).to(places.point)
    answers = responses(places.normal, places.view, places.material.roughness, towards, form)
    if occluder is not None:
        seen = occluder.of_all(places.point, places.normal.detach(), towards)
        answers = seen_through(answers, seen)
    return places.total(coloured(places.material, answers, light.evaluate(towards) * (4.0 * math.pi / samples)))
