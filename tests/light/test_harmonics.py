"""Spherical harmonics against scipy's, their orthonormality, and irradiance against its integral."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import sph_harm_y

from handbench.errors import InputError
from handbench.light.environment import directions, solid_angles
from handbench.light.harmonics import HIGHEST, cosine_lobe, harmonics, turned

SPHERE, WEIGHTS = directions(90, 180).reshape(-1, 3), solid_angles(90, 180).ravel()


def test_they_are_orthonormal() -> None:
    found = harmonics(SPHERE, HIGHEST)
    assert np.allclose(found.T @ (WEIGHTS[:, None] * found), np.eye((HIGHEST + 1) ** 2), atol=2e-3)


def test_they_are_those_of_scipy() -> None:
    x, y, z = SPHERE.T
    polar, azimuth = np.arccos(z), np.arctan2(y, x)
    expected = []
    for degree in range(HIGHEST + 1):
        for order in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(order), polar, azimuth) * (-1.0) ** order  # without the phase
            part = value.real if order >= 0 else value.imag
            expected.append(part if order == 0 else np.sqrt(2.0) * part)
    assert np.allclose(harmonics(SPHERE, HIGHEST), np.stack(expected, axis=-1), atol=1e-12)


def test_irradiance_is_the_integral_of_the_cosine() -> None:
    rng = np.random.default_rng(0)
    light = rng.normal(size=(HIGHEST + 1) ** 2)
    radiance = harmonics(SPHERE, HIGHEST) @ light
    normals = rng.normal(size=(5, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for normal in normals:
        integral = (WEIGHTS * radiance * np.maximum(SPHERE @ normal, 0.0)).sum()
        told = harmonics(normal, HIGHEST) @ (cosine_lobe(HIGHEST) * light)
        assert np.isclose(integral, told, atol=5e-3 * np.abs(light).sum())


def test_a_degree_that_is_not_there_is_refused() -> None:
    with pytest.raises(InputError, match="use 0 to 3"):
        harmonics(SPHERE, 4)


@pytest.mark.parametrize("degree", range(HIGHEST + 1))
def test_turning_them_is_seeing_the_direction_in_turned_axes(degree: int) -> None:
    axes = Rotation.random(5, rng=3).as_matrix()
    axes[-1] *= -1.0  # mirrored ones as well
    some = SPHERE[::997]
    wanted = harmonics(np.einsum("nij,pj->npi", axes, some), degree)
    known = harmonics(some, degree)
    for d, matrices in enumerate(turned(axes, degree)):
        of = slice(d * d, (d + 1) ** 2)
        assert np.allclose(np.einsum("nij,pj->npi", matrices, known[:, of]), wanted[..., of], atol=1e-12)
