"""The shading features written out as printed, in jax float64: slow, plain, and independent of the fast path.

URHand, supplement Sec. 4.2. Outside the equations' domain (light or viewer below the surface) a feature is zero.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..scene import Array


def distribution(h_dot_n: jax.Array, roughness: jax.Array) -> jax.Array:
    """Eq. 3."""
    return roughness**4 / (jnp.pi * (h_dot_n**2 * (roughness**4 - 1) + 1) ** 2)


def fresnel(d_dot_h: jax.Array) -> jax.Array:
    """Eq. 4."""
    return 0.04 + (1 - 0.04) * 2 ** ((-5.55473 * d_dot_h - 6.98316) * d_dot_h)


def geometry(n_dot_d: jax.Array, n_dot_light: jax.Array, roughness: jax.Array) -> jax.Array:
    """Eqs. 5 and 6."""
    k = (roughness + 1) ** 2 / 8
    return 1 / (4 * (n_dot_d * (1 - k) + k) * (n_dot_light * (1 - k) + k))


def _one(normal, view, roughness, direction, irradiance, visibility):  # type: ignore[no-untyped-def]
    """The terms of Eqs. 1 and 2 for one texel and one light."""
    cosine = direction @ normal
    half = (direction + view) / jnp.linalg.norm(direction + view)
    brdf = distribution(half @ normal, roughness) * fresnel(view @ half) * geometry(normal @ view, cosine, roughness)
    diffuse = jnp.where(cosine > 0, irradiance * visibility * cosine, 0.0)
    return diffuse, jnp.where(normal @ view > 0, brdf * diffuse, 0.0)


def shading_features(
    normal: Array, view: Array, roughness: Array, directions: Array, irradiance: Array, visibility: Array
) -> tuple[Array, Array]:
    """Eqs. 1 and 2: normal (N, 3), view (N, 3), roughness (N), directions (L, 3), irradiance (L, 3),
    visibility (L, N) to diffuse (N, 3) and specular (N, 3), float64."""
    with jax.enable_x64(True):
        arrays = [jnp.asarray(values, jnp.float64) for values in (normal, view, roughness)]
        lights = [jnp.asarray(values, jnp.float64) for values in (directions, irradiance)]
        over_texels = jax.vmap(_one, in_axes=(0, 0, 0, None, None, 0))
        over_lights: Callable[..., Any] = jax.vmap(over_texels, in_axes=(None, None, None, 0, 0, 0))
        terms = over_lights(*arrays, *lights, jnp.asarray(visibility, jnp.float64))
        diffuse, specular = (np.asarray(term.sum(axis=0)) for term in terms)
        return diffuse, specular
