"""The reflectance models and features written out as printed, in jax: slow, plain, independent of the fast path.

URHand, supplement Sec. 4.2. Outside the equations' domain (light or viewer below the surface) a feature is zero.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...scene import Array


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


def seed_brdf(normal, view, light, roughness):  # type: ignore[no-untyped-def]
    """Eqs. 3-6 for one texel and one light above the horizon."""
    half = (light + view) / jnp.linalg.norm(light + view)
    return (
        distribution(half @ normal, roughness)
        * fresnel(view @ half)
        * geometry(normal @ view, normal @ light, roughness)
    )


def _one(normal, view, roughness, direction, irradiance, visibility):  # type: ignore[no-untyped-def]
    """The terms of Eqs. 1 and 2 for one texel and one light."""
    cosine = direction @ normal
    brdf = seed_brdf(normal, view, direction, roughness)
    diffuse = jnp.where(cosine > 0, irradiance * visibility * cosine, 0.0)
    return diffuse, jnp.where(normal @ view > 0, brdf * diffuse, 0.0)


_over_texels = jax.vmap(_one, in_axes=(0, 0, 0, None, None, 0))
_each: Callable[..., Any] = jax.jit(jax.vmap(_over_texels, in_axes=(None, None, None, 0, 0, 0)))
"""The terms (L, N, 3) each of all lights and texels."""


def shading_features(
    normal: Array, view: Array, roughness: Array, directions: Array, irradiance: Array, visibility: Array
) -> tuple[Array, Array]:
    """Eqs. 1 and 2: normal (N, 3), view (N, 3), roughness (N), directions (L, 3), irradiance (L, 3),
    visibility (L, N) to diffuse (N, 3) and specular (N, 3), float64."""
    with jax.enable_x64(True):
        arrays = [jnp.asarray(values, jnp.float64) for values in (normal, view, roughness)]
        lights = [jnp.asarray(values, jnp.float64) for values in (directions, irradiance)]
        terms = _each(*arrays, *lights, jnp.asarray(visibility, jnp.float64))
        diffuse, specular = (np.asarray(term.sum(axis=0)) for term in terms)
        return diffuse, specular


def phong_brdf(normal, view, light, shininess):  # type: ignore[no-untyped-def]
    """Phong's lobe for one texel and one light above the horizon."""
    mirrored = 2 * (normal @ light) * normal - light
    return jnp.maximum(mirrored @ view, 0) ** shininess


def disney_brdf(normal, view, light, albedo, roughness, metallic):  # type: ignore[no-untyped-def]
    """Burley's diffuse, GGX, Schlick, height-correlated Smith through Heitz' Λ: one texel, one light above the horizon.

    Burley 2012, Sec. 5; Walter et al. 2007, Eq. 33; Heitz 2014, Eqs. 72 and 99.
    """
    alpha = roughness**2
    half = (light + view) / jnp.linalg.norm(light + view)
    facing = light @ half

    def schlick(f0, f90, cosine):  # type: ignore[no-untyped-def]
        return f0 + (f90 - f0) * (1 - cosine) ** 5

    def extra(cosine):  # type: ignore[no-untyped-def]
        """Λ."""
        tangent2 = (1 - cosine**2) / cosine**2
        return (jnp.sqrt(1 + alpha**2 * tangent2) - 1) / 2

    f90 = 0.5 + 2 * roughness * facing**2
    diffuse = albedo / jnp.pi * schlick(1, f90, normal @ light) * schlick(1, f90, normal @ view)
    ggx = alpha**2 / (jnp.pi * ((half @ normal) ** 2 * (alpha**2 - 1) + 1) ** 2)
    smith = 1 / (1 + extra(normal @ light) + extra(normal @ view))
    colour = schlick(0.04 * (1 - metallic) + albedo * metallic, 1.0, facing)
    return (1 - metallic) * diffuse + ggx * smith * colour / (4 * (normal @ light) * (normal @ view))
