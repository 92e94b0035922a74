"""Directions in which scattered light is gathered: strata of the sphere, where the light is, or where the skin looks.

All estimate the same sum, radiance at P points = integral of f cos L V over the sphere, and differ in noise alone. A
sample's `power` is what `reflectance.coloured` multiplies with: radiance over density over number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import torch
from torch import Tensor

from handbench.errors import InputError
from handbench.render.shade.brdf import base_reflectance, distribution
from handbench.scene import Array

from .light import LightSampler, frame
from .reflectance import Form, Material, width

Sampling: TypeAlias = Literal["strata", "light", "combined"]
"""Uniform strata of the sphere (training), light importance (the released relighting), or both light and reflectance
with the balance heuristic (in the released code, and in none of its settings)."""

_LUMINANCE = (0.2126, 0.7152, 0.0722)


@dataclass(frozen=True, eq=False)
class DirectionSamples:
    """Directions (D, 3) for all points, or (P, D, 3), and what comes from each, power of the same shape."""

    directions: Tensor
    power: Tensor


def strata(count: int, rng: np.random.Generator | None = None, sets: int = 1) -> Array:
    """`sets` times `count` unit directions (sets, D, 3), one in each stratum of the sphere: at random, or its middle.

    Strata have equal solid angles: rows of equal height, about half as many as columns (512: 16 x 32, as released).
    """
    rows = next(r for r in range(max(1, math.isqrt(count // 2)), 0, -1) if count % r == 0)
    columns = count // rows
    place = np.full((sets, count, 2), 0.5) if rng is None else rng.random((sets, count, 2))
    i, j = np.divmod(np.arange(count), columns)
    up = 1.0 - 2.0 * (i + place[..., 0]) / rows
    phi = 2.0 * np.pi * (j + place[..., 1]) / columns
    ring = np.sqrt(np.maximum(0.0, 1.0 - up * up))
    return np.stack([ring * np.sin(phi), up, -ring * np.cos(phi)], axis=-1)


def gather(
    how: Sampling,
    sky: LightSampler,
    count: int,
    points: tuple[Tensor, Tensor, Material],
    form: Form,
    rng: np.random.Generator,
    fresh: bool = False,
) -> DirectionSamples:
    """`count` directions for points (normal (P, 3), view (P, 3), material), and their power.

    "strata" and "light" draw one set for all points, or with `fresh` one for each: noise then takes the place of what
    neighbours share (the released code for its figures and its numbers). "combined" depends on the points, so its own
    half is always fresh. Raises `InputError` for less than 2 directions.
    """
    if count < 2:
        raise InputError(f"light is gathered from {count} directions; give at least 2")
    sets = len(points[0]) if fresh else 1
    match how:
        case "strata":
            towards = torch.from_numpy(strata(count, rng, sets)).float()
            power = _radiance(sky, towards) * (4.0 * math.pi / count)
        case "light":
            towards = sky.draw(_stratified(sets, count, rng)).float().reshape(sets, count, 3)
            power = _radiance(sky, towards) / (count * _density(sky, towards)[..., None])
        case "combined":
            return _combined(sky, count, points, form, rng)
    return DirectionSamples(towards, power) if fresh else DirectionSamples(towards[0], power[0])


def _combined(
    sky: LightSampler, count: int, points: tuple[Tensor, Tensor, Material], form: Form, rng: np.random.Generator
) -> DirectionSamples:
    """Half of the directions from the light, the others from the reflectance, each over the density of both."""
    normal, view, material = points
    lit, own = count - count // 2, count // 2
    from_light = sky.draw(_stratified(1, lit, rng)).float()[None].expand(len(normal), -1, -1)
    from_skin = _drawn(normal, view, material, form, _stratified(len(normal), own, rng).reshape(-1, own, 3))
    towards = torch.cat([from_light, from_skin], dim=1)
    both = lit * _density(sky, towards) + own * _skin_density(towards, normal, view, material, form)
    # a direction below the horizon has no density of the skin, and none of it reflects
    return DirectionSamples(towards, _radiance(sky, towards) / both.clamp_min(1e-12)[..., None])


def _stratified(sets: int, count: int, rng: np.random.Generator) -> Array:
    """Numbers (sets * count, 3) in [0, 1), of each set one in every part of the first axis."""
    numbers = rng.random((sets, count, 3))
    numbers[..., 0] = (np.arange(count) + numbers[..., 0]) / count
    return np.minimum(numbers, np.nextafter(1.0, 0.0)).reshape(-1, 3)


def _radiance(sky: LightSampler, towards: Tensor) -> Tensor:
    return sky.radiance(towards.reshape(-1, 3)).float().reshape(towards.shape)


def _density(sky: LightSampler, towards: Tensor) -> Tensor:
    return sky.density(towards.reshape(-1, 3)).float().reshape(towards.shape[:-1])


# -- where the skin looks -------------------------------------------------------------------------------------------


def _glossy(material: Material) -> Tensor:
    """The share (P) of directions that are drawn for the lobe: of what it and the diffuse part reflect head-on."""
    weights = torch.tensor(_LUMINANCE)
    lobe = base_reflectance(material.albedo, material.metallic[:, None]) @ weights
    diffuse = (1.0 - material.metallic) * (material.albedo @ weights)
    return (lobe / (lobe + diffuse).clamp_min(1e-6)).clamp(0.1, 0.9)


@torch.no_grad()
def _drawn(normal: Tensor, view: Tensor, material: Material, form: Form, uniform: Array) -> Tensor:
    """Directions (P, D, 3): by the cosine, or mirrored at normals of the lobe's distribution (Walter et al. 2007)."""
    pick, u, v = (torch.from_numpy(np.ascontiguousarray(uniform[..., k])).float() for k in range(3))
    first, second = (axis[:, None] for axis in frame(normal))
    up, phi = normal[:, None], (2.0 * math.pi * v)[..., None]
    around = phi.cos() * first + phi.sin() * second
    even = u.sqrt()[..., None] * around + (1.0 - u).sqrt()[..., None] * up
    alpha2 = width(material.roughness, form).square()[:, None]
    cosine2 = (1.0 - u) / (1.0 + (alpha2 - 1.0) * u)
    half = (1.0 - cosine2).clamp_min(0.0).sqrt()[..., None] * around + cosine2.sqrt()[..., None] * up
    mirrored = 2.0 * (half @ view[:, :, None]) * half - view[:, None]
    glossy = pick < _glossy(material)[:, None]
    return torch.nn.functional.normalize(torch.where(glossy[..., None], mirrored, even), dim=2)


@torch.no_grad()
def _skin_density(towards: Tensor, normal: Tensor, view: Tensor, material: Material, form: Form) -> Tensor:
    """How likely `_drawn` gives directions (P, D, 3), (P, D) per steradian."""
    cosine = (towards @ normal[:, :, None])[..., 0].clamp_min(0.0)
    half = torch.nn.functional.normalize(towards + view[:, None], dim=2)
    upright, facing = ((half @ axis[:, :, None])[..., 0] for axis in (normal, view))
    root = width(material.roughness, form).sqrt()[:, None]
    lobe = distribution((1.0 - upright.square()).clamp(0.0, 1.0), root) * upright / (4.0 * facing).clamp_min(1e-6)
    share = _glossy(material)[:, None]
    return share * (upright > 0) * lobe + (1.0 - share) * cosine / math.pi
