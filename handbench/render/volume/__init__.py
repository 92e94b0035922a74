"""Volume rendering near a surface: where on a ray to look, and how much of what is there reaches the eye.

shell = Shell.around(vertices, faces)                       where a surface may be
intervals = through(shell, origins, directions, marching)   of each ray the parts worth looking at
weights = quadrature.weights(density, intervals.length)     (R, S)
"""

from __future__ import annotations

from .quadrature import laplace_density, transmittance, weights
from .sampling import Intervals, Marching, refined, through
from .shell import Shell

__all__ = ["Intervals", "Marching", "Shell", "laplace_density", "refined", "through", "transmittance", "weights"]
