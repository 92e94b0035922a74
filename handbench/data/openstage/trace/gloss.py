"""What skin reflects at its surface: two GGX lobes, one sharper and one broader, and the light they let through.

Light that is not reflected enters: the share 1 - E(cosine), E being all that the lobes reflect of a direction
(Kelemen and Szirmay-Kalos, "A microfacet based coupled specular-matte BRDF model", 2001). What comes out of the
skin is weighted by the same share, so a surface that absorbs nothing gives back exactly what it receives.
Each lobe is the specular one of Mitsuba's principled BSDF: separable Smith masking, Fresnel of a dielectric.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from ....scene import Array

WEIGHTS = (0.7, 0.3)
"""Of the sharper and the broader lobe, as measured on skin (Weyrich et al., "Analysis of human faces", 2006)."""

BROADER = 1.7
"""Roughness of the broader lobe, times that of the sharper one."""

_COSINES, _ROUGHNESSES = 256, 64


def dot(a: Array, b: Array) -> Array:
    """Dot products of vectors (N, 3) or (1, 3)."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def alphas(roughness: Array) -> tuple[Array, Array]:
    """GGX widths of the two lobes for roughness in [0, 1]."""
    return _alpha(roughness), _alpha(np.minimum(roughness * BROADER, 1.0))


def _alpha(roughness: Array) -> Array:
    return np.maximum(roughness**2, 1e-3)


def fresnel(cosine: Array, specular: float) -> Array:
    """Reflectance of a dielectric at a cosine in [0, 1]; specular 0.5 is an index of refraction of 1.5."""
    if specular == 0:
        return np.zeros_like(cosine)
    eta = 2 / (1 - np.sqrt(0.08 * specular)) - 1
    inside = np.sqrt(1 - (1 - cosine * cosine) / eta**2)
    parallel = (eta * cosine - inside) / (eta * cosine + inside)
    across = (cosine - eta * inside) / (cosine + eta * inside)
    return 0.5 * (parallel * parallel + across * across)


def lobe(alpha: Array, normal_half: Array, normal_light: Array, normal_view: Array) -> Array:
    """BRDF of one lobe without Fresnel, times the cosine to the light; all cosines positive."""
    narrow = alpha * alpha
    spread = normal_half * normal_half * (narrow - 1) + 1
    masked_light = normal_light + np.sqrt(normal_light * normal_light * (1 - narrow) + narrow)
    masked_view = normal_view + np.sqrt(normal_view * normal_view * (1 - narrow) + narrow)
    return narrow * normal_light / (np.pi * spread * spread * masked_light * masked_view)


def gloss(roughness: Array, specular: float, normal_light: Array, normal_view: Array, light_view: Array) -> Array:
    """BRDF of both lobes times the cosine to the light, from the cosines between normal, light and view."""
    half = np.sqrt(np.maximum(2 + 2 * light_view, 1e-9))
    normal_half = np.minimum((normal_light + normal_view) / half, 1.0)
    total = sum(
        weight * lobe(alpha, normal_half, normal_light, normal_view)
        for weight, alpha in zip(WEIGHTS, alphas(roughness), strict=True)
    )
    return total * fresnel(np.minimum(0.5 * half, 1.0), specular)


def density(roughness: Array, normal_light: Array, normal_view: Array, light_view: Array) -> Array:
    """Probability density of directions to the light that `sample` finds from the lobes, chosen by `WEIGHTS`."""
    half = np.sqrt(np.maximum(2 + 2 * light_view, 1e-9))
    normal_half = np.minimum((normal_light + normal_view) / half, 1.0)
    total = np.zeros_like(normal_half)
    for weight, alpha in zip(WEIGHTS, alphas(roughness), strict=True):
        narrow = alpha * alpha
        spread = normal_half * normal_half * (narrow - 1) + 1
        masked = normal_view + np.sqrt(normal_view * normal_view * (1 - narrow) + narrow)
        total += weight * narrow / (2 * np.pi * spread * spread * masked)
    return total


def sample(alpha: Array, view: Array, u: Array, v: Array) -> Array:
    """Half vectors (N, 3) in the frame of the normal, among those that the view (N, 3) sees.

    Heitz, "Sampling the GGX distribution of visible normals", 2018.
    """
    stretched = view * np.stack([alpha, alpha, np.ones_like(alpha)], axis=1)
    stretched /= np.sqrt(dot(stretched, stretched))[:, None]
    across = np.hypot(stretched[:, 0], stretched[:, 1])
    flat = across < 1e-7
    safe = np.where(flat, 1.0, across)
    first = np.stack(
        [np.where(flat, 1.0, -stretched[:, 1] / safe), np.where(flat, 0.0, stretched[:, 0] / safe)], axis=1
    )
    first = np.concatenate([first, np.zeros((len(first), 1), first.dtype)], axis=1)
    second = np.cross(stretched, first)
    radius, turn = np.sqrt(u), 2 * np.pi * v
    x, y = radius * np.cos(turn), radius * np.sin(turn)
    tilt = 0.5 * (1 + stretched[:, 2])
    y = (1 - tilt) * np.sqrt(np.maximum(1 - x * x, 0)) + tilt * y
    z = np.sqrt(np.maximum(1 - x * x - y * y, 0))
    half = x[:, None] * first + y[:, None] * second + z[:, None] * stretched
    half *= np.stack([alpha, alpha, np.ones_like(alpha)], axis=1)
    half[:, 2] = np.maximum(half[:, 2], 1e-6)
    return half / np.sqrt(dot(half, half))[:, None]


@dataclass(frozen=True, eq=False)
class Reflected:
    """All that both lobes reflect: of a direction, by cosine and roughness, and of light from everywhere."""

    of_direction: Array
    of_all: Array

    def at(self, cosine: Array, roughness: Array) -> Array:
        """E of cosines in [0, 1] and roughness, of shapes that broadcast."""
        row = (roughness * (_ROUGHNESSES - 1) + 0.5).astype(np.int32) * _COSINES
        return self.of_direction.ravel()[row + (cosine * (_COSINES - 1) + 0.5).astype(np.int32)]

    def mean(self, roughness: Array) -> Array:
        """E of uniform light."""
        return self.of_all[(roughness * (_ROUGHNESSES - 1) + 0.5).astype(np.int32)]


@cache
def reflected(specular: float) -> Reflected:
    """Tables of E: 256 half vectors at 32 cosines and 25 kinds of roughness, interpolated."""
    count, rough, steep = 256, np.linspace(0, 1, 25), np.maximum(np.linspace(0, 1, 32) ** 2, 1e-3)
    pairs = np.stack(np.meshgrid(rough, steep, indexing="ij"), axis=-1).reshape(-1, 1, 2)
    roughness, cosine = (np.broadcast_to(pairs[..., k], (len(pairs), count)).ravel() for k in range(2))
    u = np.tile((np.arange(count) + 0.5) / count, len(pairs))
    v = np.tile((np.arange(count) * 0.6180339887498949) % 1.0, len(pairs))
    view = np.stack([np.sqrt(1 - cosine**2), np.zeros_like(cosine), cosine], axis=1)
    total = np.zeros(len(roughness))
    for weight, alpha in zip(WEIGHTS, alphas(roughness), strict=True):
        half = sample(alpha, view, u, v)
        facing = np.clip((half * view).sum(axis=1), 0, 1)
        light = 2 * facing * half[:, 2] - cosine
        masked = light + np.sqrt(light * light * (1 - alpha**2) + alpha**2)
        total += weight * np.where(light > 0, fresnel(facing, specular) * 2 * light / masked, 0)
    coarse = total.reshape(len(rough), len(steep), count).mean(axis=2)
    fine = np.linspace(0, 1, _COSINES)
    banded = np.stack([np.interp(fine, steep, row) for row in coarse])
    table = np.stack([np.interp(np.linspace(0, 1, _ROUGHNESSES), rough, column) for column in banded.T], axis=1)
    mean = np.trapezoid(2 * table * fine, fine, axis=1)
    return Reflected(table.astype(np.float32), np.asarray(mean, np.float32))
