"""One distant light that stays where it is in the world, and the albedo under it, solved together.

The light is told by spherical harmonics of degree 2, so its shading is I = a(t) sum_i A_i L_i Y_i(n): no shadows, no
highlights. A hand that turns shows each texel under several normals, which tells light and albedo apart but for a
factor in each channel; a single picture tells the light that explains a hand of one colour best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handbench.light.environment import directions
from handbench.light.harmonics import cosine_lobe, harmonics
from handbench.scene import Array

from .unwrap import UnwrappedPicture

DEGREE = 2
_TRUSTED = 0.1  # relative residual from which a texel counts less: it is in shadow, or a highlight
_DARKEST = 0.05  # of the mean irradiance: no light is negative, and harmonics of degree 2 ring


@dataclass(frozen=True)
class Decomposed:
    """colour (3, N): the texture under a mean shading of 1, zero where unseen; light (9, 3): coefficients whose
    irradiance has that mean where pictures saw the hand."""

    colour: Array
    light: Array

    def shading(self, normal: Array) -> Array:
        """What the light makes of the colour at unit normals (N, 3): factors (3, N), none negative."""
        return np.maximum(irradiance(normal) @ self.light, 0.0).T


def irradiance(normal: Array) -> Array:
    """The irradiance (N, 9) at unit normals (N, 3) under each harmonic."""
    return harmonics(normal, DEGREE) * cosine_lobe(DEGREE)


def decomposed(pictures: Sequence[UnwrappedPicture], mean: Array, foreground: Array, rounds: int = 8) -> Decomposed:
    """Light and albedo of pictures by alternating least squares.

    They start from the mean texture (3, N): over a turn the light evens out, and what is lighter in it is lighter skin.
    A single picture starts from its mean colour (3,): it alone cannot tell light from skin.
    """
    colour = mean if len(pictures) > 1 else np.tile(foreground[:, None], (1, mean.shape[1]))
    trust = [np.ones_like(picture.weight) for picture in pictures]
    light = np.zeros((9, 3))
    for _ in range(rounds):
        light = _light(pictures, colour, trust)
        mean = _mean_shading(pictures, light)
        light = light / mean
        colour = _colour(pictures, light, trust)
        trust = [_trust(picture, colour, light) for picture in pictures]
    return Decomposed(colour, light)


def _light(pictures: Sequence[UnwrappedPicture], colour: Array, trust: Sequence[Array]) -> Array:
    """The light (9, 3) that explains the pictures best, its irradiance nowhere negative."""
    normal, right = np.zeros((3, 9, 9)), np.zeros((3, 9))
    for picture, sure in zip(pictures, trust, strict=True):
        on = picture.weight > 0
        weight, shading = picture.weight[on] * sure[on], irradiance(picture.normal[on])
        for c in range(3):
            lit = colour[c, on, None] * shading
            normal[c] += lit.T @ (weight[:, None] * lit)
            right[c] += lit.T @ (weight * picture.colour[c, on])
    hold = 1e-4 * np.trace(normal, axis1=1, axis2=2)[:, None, None] / 9 * np.diag(np.r_[0.0, np.ones(8)])
    found = np.linalg.solve(normal + hold, right[..., None])[..., 0].T
    found[0] = np.maximum(found[0], 1e-9)
    return _nonnegative(found)


def _nonnegative(light: Array) -> Array:
    """The light with all but its mean weakened, channel by channel, until no irradiance is below `_DARKEST` of it."""
    mean = irradiance(np.array([[0.0, 1.0, 0.0]]))[0, 0] * light[0]
    swing = irradiance(_EVERYWHERE)[:, 1:] @ light[1:]
    lowest = -swing.min(axis=0)
    factor = np.minimum(1.0, (1.0 - _DARKEST) * mean / np.maximum(lowest, 1e-12))
    return np.concatenate([light[:1], factor * light[1:]])


_EVERYWHERE = directions(16, 32).reshape(-1, 3)


def _mean_shading(pictures: Sequence[UnwrappedPicture], light: Array) -> Array:
    """The mean (3,) of the light's irradiance over what pictures show."""
    total = sum(picture.weight @ irradiance(picture.normal) for picture in pictures)
    return (total @ light) / sum(picture.weight.sum() for picture in pictures)


def _colour(pictures: Sequence[UnwrappedPicture], light: Array, trust: Sequence[Array]) -> Array:
    """The colours (3, N) that explain the pictures best; zero where there are none."""
    top, bottom = np.zeros_like(pictures[0].colour), np.zeros_like(pictures[0].colour)
    for picture, sure in zip(pictures, trust, strict=True):
        shading = (irradiance(picture.normal) @ light).T
        top += picture.weight * sure * picture.colour * shading
        bottom += picture.weight * sure * shading**2
    return np.maximum(np.divide(top, bottom, out=np.zeros_like(top), where=bottom > 0), 0.0)


def _trust(picture: UnwrappedPicture, colour: Array, light: Array) -> Array:
    """The weights (N,) of a robust fit: one where a picture is explained, less the more it is not."""
    told = colour * (irradiance(picture.normal) @ light).T
    residual = np.abs(picture.colour - told).sum(axis=0) / np.maximum(told.sum(axis=0), 1e-6)
    return np.minimum(1.0, _TRUSTED / np.maximum(residual, 1e-6))
