"""Real spherical harmonics of low degree, and the irradiance of light that is told in them.

Ramamoorthi and Hanrahan, "An Efficient Representation for Irradiance Environment Maps" (2001). A degree d has
(d + 1)^2 functions, ordered by degree, then from -d to d.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..errors import InputError
from ..scene import Array

HIGHEST = 3
_LOBE = (math.pi, 2.0 * math.pi / 3.0, math.pi / 4.0, 0.0)  # the clamped cosine, degree by degree
_KNOWN = 12  # directions, more than the highest degree has functions


def harmonics(directions: Array, degree: int) -> Array:
    """The functions (..., (degree + 1)^2) at unit directions (..., 3); orthonormal on the sphere.

    Raises `InputError` for a degree that is not 0 to 3.
    """
    x, y, z = np.moveaxis(np.asarray(directions), -1, 0)
    return np.stack(harmonics_of(x, y, z, degree), axis=-1)


def harmonics_of(x: Any, y: Any, z: Any, degree: int) -> list[Any]:
    """The functions at unit directions of coordinates x, y and z, each as they are: arrays or tensors of any shape.

    Raises `InputError` for a degree that is not 0 to 3.
    """
    if not 0 <= degree <= HIGHEST:
        raise InputError(f"spherical harmonics of degree {degree} are not there; use 0 to {HIGHEST}")
    rows = [0.5 / math.sqrt(math.pi) + 0.0 * x]
    if degree > 0:
        one = math.sqrt(0.75 / math.pi)
        rows += [one * y, one * z, one * x]
    if degree > 1:
        two = 0.5 * math.sqrt(15.0 / math.pi)
        rows += [two * x * y, two * y * z, 0.25 * math.sqrt(5.0 / math.pi) * (3 * z * z - 1)]
        rows += [two * x * z, 0.5 * two * (x * x - y * y)]
    if degree > 2:
        a, b = 0.25 * math.sqrt(35.0 / (2.0 * math.pi)), 0.25 * math.sqrt(21.0 / (2.0 * math.pi))
        c, d = 0.5 * math.sqrt(105.0 / math.pi), 0.25 * math.sqrt(7.0 / math.pi)
        rows += [a * y * (3 * x * x - y * y), c * x * y * z, b * y * (5 * z * z - 1), d * z * (5 * z * z - 3)]
        rows += [b * x * (5 * z * z - 1), 0.5 * c * z * (x * x - y * y), a * x * (x * x - 3 * y * y)]
    return rows


def turned(axes: Array, degree: int) -> list[Array]:
    """What turning does to the functions of each degree d, (N, 2 d + 1, 2 d + 1), for axes (N, 3, 3) whose rows are
    orthonormal: of a direction in those axes they are these matrices times those of the direction itself.

    A degree keeps to itself when it is turned, so a few known directions, here on a spiral, tell its matrix exactly.
    """
    height = 1.0 - (2.0 * np.arange(_KNOWN) + 1.0) / _KNOWN
    around = np.pi * (3.0 - math.sqrt(5.0)) * np.arange(_KNOWN)
    radius = np.sqrt(1.0 - height**2)
    known = np.stack([radius * np.cos(around), radius * np.sin(around), height], axis=1)
    plain = harmonics(known, degree)  # (P, K)
    seen = harmonics(np.matmul(axes, known.T).swapaxes(-1, -2), degree)  # (N, P, K)
    degrees = [slice(d * d, (d + 1) ** 2) for d in range(degree + 1)]
    return [np.matmul(np.linalg.pinv(plain[:, of]), seen[..., of]).swapaxes(-1, -2) for of in degrees]


def cosine_lobe(degree: int) -> Array:
    """What the clamped cosine makes of each function, ((degree + 1)^2,): irradiance is `harmonics` of the normal times
    this times the light's coefficients. Degree 2 is within 1 % of the irradiance of distant light, on average."""
    return np.repeat(_LOBE[: degree + 1], [2 * d + 1 for d in range(degree + 1)])
