"""Spherical Gaussians: a map as a sum of a few smooth lobes (Wang et al. 2009), as PALM-Net lights its hands.

A lobe of unit axis m, sharpness s and amplitude a adds a exp(s (m.v - 1)) to the radiance from direction v.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import torch
from scipy.optimize import nnls
from torch import Tensor

from ..errors import InputError
from ..scene import Array, Environment
from .environment import directions, solid_angles
from .reduction import reduced

_SERIES = 0.02
"""Below this sharpness the integral is summed as a series: the closed form is 0/0 at 0, its gradient inexact near."""

_STEPS = 100
"""Of Levenberg-Marquardt at most."""

_SLOW, _STUCK, _TINY = 1e-7, 1e8, 1e-300
"""The least relative gain of a step that is followed by another; a damping that no step survives."""

_FLATTEST, _SHARPEST = 1e-3, 5.0
"""Bounds of a fitted sharpness; the upper one as the square of this over the height of a texel in radians."""


@dataclass(frozen=True, eq=False)
class SphericalGaussians:
    """G lobes as tensors of one dtype: axes (G, 3) unit, sharpness (G) at least 0, amplitude (G, 3) radiance.

    Raises `InputError` for shapes that do not fit, axes that are not unit and negative sharpness. All
    functions are differentiable in all three, for any sharpness from 0 (from all around) to 1e6 (a tenth of a degree).
    """

    axes: Tensor
    sharpness: Tensor
    amplitude: Tensor

    def __post_init__(self) -> None:
        count = len(self.axes)
        if self.axes.shape != (count, 3) or self.sharpness.shape != (count,) or self.amplitude.shape != (count, 3):
            shapes = ", ".join(str(tuple(t.shape)) for t in (self.axes, self.sharpness, self.amplitude))
            raise InputError(f"spherical Gaussians: axes, sharpness, amplitude are {shapes}; give (G, 3), (G), (G, 3)")
        with torch.no_grad():
            if not (self.axes.square().sum(dim=1) - 1.0).abs().le(1e-3).all():
                raise InputError("spherical Gaussians: the axes are not all unit vectors; normalise them")
            if not self.sharpness.ge(0.0).all():
                raise InputError("spherical Gaussians: sharpness is negative or NaN; give 0 or more")

    def __len__(self) -> int:
        return len(self.axes)

    def evaluate(self, towards: Tensor) -> Tensor:
        """Radiance (N, 3) from unit directions (N, 3)."""
        return lobes(self.axes, self.sharpness, towards) @ self.amplitude

    def integral(self) -> Tensor:
        """Radiance summed over the sphere, (3): the power that `handbench.light` keeps."""
        return integrals(self.sharpness) @ self.amplitude

    def to_environment(self, height: int, width: int, name: str = "spherical Gaussians") -> Environment:
        """The map (H, W) of the lobes; each keeps its power, also where it is narrower than a texel."""
        towards, solid = _texels(height, width, self.axes.dtype)
        with torch.no_grad():
            shares = _shares(self.axes, self.sharpness, towards, solid)
            radiance = shares @ (integrals(self.sharpness)[:, None] * self.amplitude)
        return Environment(name, radiance.reshape(height, width, 3).numpy())


def lobes(axes: Tensor, sharpness: Tensor, towards: Tensor) -> Tensor:
    """exp(s (m.v - 1)) of directions (N, 3) for axes (G, 3) and sharpness (G), (N, G); all vectors are unit."""
    return torch.exp(-sharpness * _distances(axes, towards))


def integrals(sharpness: Tensor) -> Tensor:
    """The integral of each lobe of amplitude 1 over the sphere, 2 pi (1 - exp(-2 s)) / s, (G); 4 pi at s = 0."""
    near = sharpness < _SERIES
    safe = torch.where(near, torch.ones_like(sharpness), sharpness)
    x = -2.0 * torch.where(near, sharpness, torch.zeros_like(sharpness))
    series = torch.ones_like(x)
    for k in range(8, 1, -1):  # expm1(x) / x = 1 + x / 2 (1 + x / 3 (1 + ...
        series = 1.0 + x / k * series
    return 2.0 * math.pi * torch.where(near, 2.0 * series, -torch.expm1(-2.0 * safe) / safe)


def fit(environment: Environment, count: int) -> SphericalGaussians:
    """Lobes (float64) that come close to the map in the least squares of its radiance over the sphere.

    Starts at the `count` lights of `reduced` and improves all parameters at once (Levenberg-Marquardt, amplitudes
    at least 0), then scales each colour to the map's power. No lobe is sharper than the texels can tell. Fit maps of
    about 32 x 64 texels: time grows with texels times lobes squared. A dark map has lobes of amplitude 0. Nothing is
    random.
    Raises `InputError` if `count` is below 1.
    """
    if count < 1:
        raise InputError(f"environment {environment.name!r}: {count} spherical Gaussians are none; ask for at least 1")
    height, width = environment.radiance.shape[:2]
    towards, solid = (values.numpy() for values in _texels(height, width, torch.float64))
    radiance = environment.radiance.reshape(-1, 3).astype(np.float64)
    scale = radiance.max()
    axes, sharpness = _start(environment, count)
    sharpest = (_SHARPEST * height / np.pi) ** 2
    fitter = _Fitter(towards, solid, radiance / scale if scale else radiance, sharpest)
    axes, sharpness, power = fitter.run(axes, np.clip(sharpness, _FLATTEST, sharpest))
    whole, found = solid @ radiance, scale * power.sum(axis=0)
    power *= np.divide(whole, found, out=np.ones(3), where=found > 0.0)
    known = torch.from_numpy(sharpness)
    amplitude = torch.from_numpy(power * scale) / integrals(known)[:, None]
    return SphericalGaussians(torch.from_numpy(axes), known, amplitude)


_Lobes: TypeAlias = tuple[Array, Array, Array]
"""Axes (G, 3), sharpness (G) and power (G, 3), the integral of each lobe's radiance."""


class _Fitter:
    """Levenberg-Marquardt for the lobes of one map: radiance (T, 3) of texels in unit directions (T, 3)."""

    def __init__(self, towards: Array, solid: Array, radiance: Array, sharpest: float) -> None:
        self._towards, self._solid, self._sharpest = towards, solid, sharpest
        self._weight = np.sqrt(solid)[:, None]
        self._target = self._weight * radiance

    def run(self, axes: Array, sharpness: Array) -> _Lobes:
        """The lobes after the steps that lower the squares, from lobes of the best power."""
        shares = self._shares(axes, sharpness)
        power = np.stack([nnls(self._weight * shares, channel)[0] for channel in self._target.T], axis=1)
        lobes, squares, damping = (axes, sharpness, power), self._squares(shares, power), 1e-2
        for _ in range(_STEPS):
            system = self._linearised(lobes, shares)
            while damping < _STUCK:
                trial = self._step(lobes, damping, *system)
                shares = self._shares(*trial[:2])
                after = self._squares(shares, trial[2])
                if after < squares:
                    break
                damping *= 4.0
            else:
                break
            slow = squares - after < _SLOW * squares
            lobes, squares, damping = trial, after, max(damping / 3.0, 1e-9)
            if slow:
                break
        return lobes

    def _shares(self, axes: Array, sharpness: Array) -> Array:
        tensors = map(torch.from_numpy, (axes, sharpness, self._towards, self._solid))
        return _shares(*tensors).numpy()

    def _squares(self, shares: Array, power: Array) -> float:
        return float(np.sum(np.square(self._weight * (shares @ power) - self._target)))

    def _linearised(self, lobes: _Lobes, shares: Array) -> tuple[Array, Array, Array]:
        """Gauss-Newton matrix (6 G, 6 G) and gradient (6 G), and the tangents (2, G, 3) in which axes move.

        Parameters: both tangents and the logarithm of the sharpness (3 G), then power by channel (3 G). A share is
        its lobe over the lobe's sum, so its derivative is the share times what the logarithm's exceeds its mean.
        """
        axes, sharpness, power = lobes
        count = len(axes)
        tangents = _tangents(axes)
        cosines = self._towards @ axes.T
        logs = [sharpness * (self._towards @ tangent.T) for tangent in tangents] + [sharpness * (cosines - 1.0)]
        columns = [shares] + [shares * (log - self._solid @ (shares * log)) for log in logs]
        basis = self._weight * np.concatenate(columns, axis=1)
        gram, pull = basis.T @ basis, basis.T @ (basis[:, :count] @ power - self._target)
        repeated = np.tile(power, (3, 1))
        matrix = np.zeros((6 * count, 6 * count))
        shape = slice(0, 3 * count)
        matrix[shape, shape] = gram[count:, count:] * (repeated @ repeated.T)
        for channel in range(3):
            part = slice((3 + channel) * count, (4 + channel) * count)
            matrix[part, part] = gram[:count, :count]
            matrix[shape, part] = gram[count:, :count] * repeated[:, channel, None]
            matrix[part, shape] = matrix[shape, part].T
        gradient = np.concatenate([(pull[count:] * repeated).sum(axis=1), pull[:count].T.ravel()])
        return matrix, gradient, tangents

    def _step(self, lobes: _Lobes, damping: float, matrix: Array, gradient: Array, tangents: Array) -> _Lobes:
        """The lobes after a damped step; power that is 0 and would fall stays."""
        axes, sharpness, power = lobes
        count = len(axes)
        free = np.concatenate([np.repeat(True, 3 * count), power.T.ravel() > 0]) | (gradient < 0)
        diagonal = np.diag(matrix)[free]
        damped = matrix[np.ix_(free, free)] + np.diag(damping * diagonal + 1e-14 * diagonal.max() + _TINY)
        move = np.zeros(6 * count)
        move[free] = -np.linalg.solve(damped, gradient[free])
        first, second, log, *rest = np.clip(move.reshape(6, count), [[-0.5]] * 3 + [[-np.inf]] * 3, np.inf)
        turned = axes + np.minimum(first, 0.5)[:, None] * tangents[0] + np.minimum(second, 0.5)[:, None] * tangents[1]
        return (
            turned / np.linalg.norm(turned, axis=1, keepdims=True),
            np.clip(sharpness * np.exp(np.minimum(log, 0.5)), _FLATTEST, self._sharpest),
            np.maximum(power + np.stack(rest, axis=1), 0.0),
        )


def _tangents(axes: Array) -> Array:
    """Two unit vectors (2, G, 3) across each unit axis (G, 3)."""
    least = np.eye(3)[np.abs(axes).argmin(axis=1)]
    first = np.cross(axes, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(axes, first)])


def _start(environment: Environment, count: int) -> tuple[Array, Array]:
    """Axes and sharpness of the first lobes: the lights of the map, each as wide as the way to its nearest one."""
    axes, _ = reduced(environment, count)
    axes = np.concatenate([axes, np.tile([[0.0, 1.0, 0.0]], (count - len(axes), 1))])
    gaps = np.square(axes[:, None] - axes).sum(axis=2)
    gaps[gaps == 0.0] = 4.0
    return axes, 2.0 / gaps.min(axis=1)


def _texels(height: int, width: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    towards, solid = directions(height, width).reshape(-1, 3), solid_angles(height, width).ravel()
    return torch.from_numpy(towards).to(dtype), torch.from_numpy(solid).to(dtype)


def _distances(axes: Tensor, towards: Tensor) -> Tensor:
    """1 - m.v as half the squared distance, (N, G): the difference itself would lose a sharp lobe's digits."""
    parts = (towards[:, k, None] - axes[:, k] for k in range(3))
    return 0.5 * sum((part.square() for part in parts), start=towards.new_zeros(()))


def _shares(axes: Tensor, sharpness: Tensor, towards: Tensor, solid: Tensor) -> Tensor:
    """The radiance (N, G) that a lobe of integral 1 has at each texel; its power is 1 whatever the sharpness."""
    away = _distances(axes, towards)
    exponent = sharpness * (away - away.amin(dim=0))  # the nearest texel counts 1, so that no sum is zero
    lobe = torch.exp(-exponent)
    return lobe / (solid @ lobe)
