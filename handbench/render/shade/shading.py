"""The light that texels reflect, summed over lights: in tiles that fit the cache, or in one fused loop.

A model is a few responses of a texel to a light of unit power, none of which has colour:
    brdf      cosine V; D F G cosine V           URHand supp. Eqs. 1-6
    phong     cosine V; (r.d)^n V
    diffuse   cosine V
    disney    diffuse; D G (1 - S); D G S, each times cosine V, S Schlick's term: see `disney_radiance`
Their sums over lights, coloured by the lights' power, are what everything here returns.

Memory: beside arguments and answers (and what autograd keeps of them) a call takes at most about 16 MB for tiles,
24 for their gradient, and 300 bytes a texel, whatever the number of lights; `transfer` alone keeps lights x texels
values.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ...errors import NonFinite
from ...light.lightset import LightSet, light_samples
from ...scene import Array
from ...skips import note, skips
from ..uv.surface import unit
from .brdf import base_reflectance
from .models import RESPONSES, Model
from .switch import answers, summed
from .tiles import Dots, distant, near

__all__ = [
    "LightSet",
    "Model",
    "disney_radiance",
    "light_features",
    "light_samples",
    "relight",
    "transfer",
]


def light_features(
    normal: Tensor,
    position: Tensor,
    roughness: Tensor,
    camera_centre: Tensor | Array,
    lights: LightSet,
    visibility: Tensor | Array | None = None,
    model: Model = "brdf",
) -> tuple[Tensor, Tensor]:
    """Diffuse and specular features (3, N) each of N texels (URHand supp. Eqs. 1-2), linear in the lights.

    normal (3, N) unit, position (3, N) and camera_centre (3,) in metres, roughness (N); visibility (L + P, N)
    bool or weights in [0, 1], rows as in `lights`; None: everything is lit. The diffuse feature is the
    irradiance; it has no 1/pi and no albedo. `model` "brdf" gives the specular feature of Eqs. 3-6, "phong" that
    of Phong (no cosine), "diffuse" zeros. Differentiable in normal (as a direction), position, roughness and, if
    `lights` holds tensors, in their irradiance and intensities. Lights without power are skipped unless they need
    a gradient (`Skips.dark_lights`); the faint ones are for `light_samples` to leave out. Half precision is raised to
    single. Raises `NonFinite` for maps with NaN or infinity.
    """
    normal, position, roughness = _checked(normal=normal, position=position, roughness=roughness)
    absent = model == "diffuse" and skips().missing_lobes
    note("lobes", 2, int(absent))
    chosen = "brdf" if model == "diffuse" and not absent else model
    sums = _shade(normal, position, roughness, camera_centre, lights, visibility, chosen)
    return sums[0], torch.zeros_like(sums[0]) if model == "diffuse" else sums[1]


def disney_radiance(
    normal: Tensor,
    position: Tensor,
    albedo: Tensor,
    roughness: Tensor,
    metallic: Tensor,
    camera_centre: Tensor | Array,
    lights: LightSet,
    visibility: Tensor | Array | None = None,
) -> Tensor:
    """Radiance (3, N) that N texels of the Disney BRDF (`brdf.disney`) send to the camera, linear in the lights.

    albedo (3, N), roughness (N) and metallic (N), clamped to [0, 1]; the rest as in `light_features`.
    Differentiable in all of them.
    """
    normal, position, roughness, albedo, metallic = _checked(
        normal=normal, position=position, roughness=roughness, albedo=albedo, metallic=metallic
    )
    albedo, metallic = albedo.clamp(0.0, 1.0), metallic.clamp(0.0, 1.0)
    diffuse, head_on, edge = _shade(normal, position, roughness, camera_centre, lights, visibility, "disney")
    return (1.0 - metallic) * albedo * diffuse + base_reflectance(albedo, metallic) * head_on + edge


def _checked(**maps: Tensor) -> tuple[Tensor, ...]:
    """The maps, at least in single precision."""
    for name, values in maps.items():
        # a float64 sum is finite if and only if all of them are, and several times faster to ask
        if not values.detach().sum(dtype=torch.float64).isfinite():
            bad = int((~values.isfinite()).sum())
            raise NonFinite(f"shading: the {name} map holds {bad} values that are NaN or infinite")
    return tuple(values.float() if values.element_size() < 4 else values for values in maps.values())


def _shade(
    normal: Tensor,
    position: Tensor,
    roughness: Tensor,
    camera_centre: Tensor | Array,
    lights: LightSet,
    visibility: Tensor | Array | None,
    model: str,
) -> Tensor:
    """The responses (K, 3, N) of a model summed over all lights."""
    maps = _maps(normal, position, roughness, camera_centre)
    split = len(lights.directions)
    kinds: tuple[tuple[Tensor | Array, Tensor | Array, Dots, slice], ...] = (
        (lights.directions, lights.irradiance, distant, slice(0, split)),
        (lights.positions, lights.intensities, near, slice(split, None)),
    )
    sums = normal.new_zeros(RESPONSES[model], *normal.shape)
    for places, powers, dots, rows in kinds:
        where, power = _tensor(places, normal.device).double(), _tensor(powers, normal.device)
        seen = None if visibility is None else _tensor(visibility[rows], normal.device)
        if skips().dark_lights and not power.requires_grad:
            lit = power.any(dim=1)
            note("dark lights", len(lit), len(lit) - int(lit.sum()))
            if not lit.all():
                where, power = where[lit], power[lit]
                seen = None if seen is None else seen[lit]
        if len(where):
            sums = sums + summed(dots, where, power.to(normal.dtype), seen, maps, model)
    return sums


def _maps(normal: Tensor, position: Tensor, roughness: Tensor, centre: Tensor | Array) -> tuple[Tensor, ...]:
    """Unit normal and view and position (3, N) in float64, and the roughness (N)."""
    position = position.double()
    return (
        unit(normal.double()),
        unit(_tensor(centre, position.device).double()[:, None] - position),
        position,
        roughness,
    )


@torch.no_grad()
def transfer(
    normal: Tensor,
    position: Tensor,
    roughness: Tensor,
    camera_centre: Tensor | Array,
    directions: Array,
    visibility: Tensor | None,
    model: Model = "brdf",
) -> Tensor:
    """What N texels answer to L distant lights of unit irradiance, (2, L, N): diffuse and specular (Eqs. 1-6), or
    (1, L, N) for the model "diffuse".

    For relighting a known pose and camera: the features are irradiance^T @ transfer, see `relight`. Takes 8 L N
    bytes (48 MB for a 16 x 32 environment at 128 texels); arguments as in `light_features`.
    """
    maps = _maps(normal, position, roughness, camera_centre)
    where = _tensor(directions, normal.device).double()
    return answers(where, visibility, maps, model, normal.dtype)


def relight(known: Tensor, irradiance: Array) -> tuple[Tensor, Tensor]:
    """Diffuse and specular features (3, N) of a `transfer` (2, L, N) under irradiance (L, 3); the latter zero without
    a lobe."""
    power = _tensor(irradiance, known.device).to(known.dtype).T
    diffuse = power @ known[0]
    return diffuse, power @ known[1] if len(known) > 1 else torch.zeros_like(diffuse)


def _tensor(values: Tensor | Array, device: torch.device) -> Tensor:
    """The values as a tensor on a device; read-only arrays are copied, which torch cannot share."""
    tensor = values if isinstance(values, Tensor) else torch.from_numpy(np.require(values, requirements="W"))
    return tensor.to(device)
