"""Procedural skin: albedo, roughness and displacement textures of a subject, drawn by anatomy and noise.

Colour is mixed as optical density, -log albedo = base + melanin + haemoglobin, so tones from very light to very
dark come from two pigments (after Tsumura et al., "Image-based skin color and texture analysis/synthesis", 2003).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ...hand.openhand import Identity, OpenHand
from ...hand.openhand.template import FINGERS
from ...scene import Array
from .creases import finger_lines, knuckle_folds, palm_lines, tendons, veins
from .noise import Noise
from .places import Places, places, smoothstep
from .tattoo import tattoo
from .translucency import mean_free_path

FOUR = FINGERS[1:]


@dataclass(frozen=True)
class SkinLook:
    """melanin 0 (very light) … 1 (very dark); haemoglobin, freckles and creases about 0 … 1; roughness about 0.45.

    polish: linear RGB of nail polish, None for bare nails. tattoo: a name of `tattoo.TATTOOS`, None for none.
    """

    melanin: float
    haemoglobin: float = 0.5
    freckles: float = 0.2
    creases: float = 1.0
    roughness: float = 0.46
    polish: tuple[float, float, float] | None = None
    tattoo: str | None = None
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Skin:
    """albedo (R, R, 3) linear, roughness (R, R), displacement (R, R) metres along the normal; float32, row 0 = top.

    bump (R, R): furrows of the skin in metres, too fine for the mesh. mean_free_path (R, R, 3): of diffuse light under
    the surface, metres, red, green, blue; 0 where nothing scatters (nail polish).
    """

    albedo: Array
    roughness: Array
    displacement: Array
    bump: Array
    mean_free_path: Array


# Optical densities of blanched skin and of one unit of each pigment, red, green, blue.
BASE = np.array([0.17, 0.36, 0.66])
MELANIN = np.array([0.42, 0.57, 0.74])
HAEMOGLOBIN = np.array([0.09, 0.55, 0.48])
VEIN = np.array([0.16, 0.06, 0.0])
INK = np.array([1.75, 1.5, 1.2])
# Under a nail light meets a thin plate and the bed: metres.
_NAIL_PATH = np.array([1.6e-3, 0.8e-3, 0.5e-3])

_TATTOO_CENTRE, _TATTOO_RADIUS = np.array([-0.001, 0.052]), 0.017


def make_skin(hand: OpenHand, identity: Identity, look: SkinLook, size: int = 1024) -> Skin:
    """The textures (size, size) of a subject; the same look gives the same textures.

    They are drawn on the neutral hand, whose UVs all identities share: `identity` stretches them with its surface
    and changes no texel. Raises `InputError` for an unknown tattoo.
    """
    at = places(hand, size)
    noise, rng = Noise(look.seed), np.random.default_rng([look.seed, 7])
    palm = smoothstep(-0.25, 0.35, at.facing + 0.06 * noise.field(at.position, 0.006))
    palm *= _below_wrist(at)
    back = 1 - palm
    lines = np.maximum(palm_lines(at, noise, rng), finger_lines(at, noise))
    folds = knuckle_folds(at, noise)
    cords = veins(at, noise, rng)
    relief = _relief(at, noise, palm)
    nail = _nail(at)
    joints = _joints(at)

    blotches = noise.cloud(at.position, 0.012)
    mottle = noise.cloud(at.position, 0.0035)
    grain = noise.field(at.position, 0.0009) * (0.25 + 0.75 * at.hand)
    tone = _tone(look)
    melanin = tone * (1 - palm * (0.35 + 0.30 * smoothstep(0.15, 0.6, np.full(1, look.melanin))))
    uneven = 0.04 * blotches + (0.025 + 0.03 * back) * mottle + 0.03 * grain
    melanin *= 1 + uneven / (1 + 0.2 * tone) + 0.16 * joints * back
    melanin += (0.16 + 0.30 * tone * (0.3 + 0.7 * palm)) * 0.7 * (look.creases * lines)
    melanin += (0.10 + 0.10 * tone) * look.creases * folds * 0.8
    melanin += back * (_freckles(at, noise, look) + _moles(at, rng))
    blood = look.haemoglobin * (0.75 + 0.09 * blotches + 0.06 * mottle + 0.05 * grain)
    blood += look.haemoglobin * (0.55 * joints * back + palm * (0.28 + 0.05 * mottle + 0.35 * _pads(at)))
    blood += look.haemoglobin * look.creases * (0.6 * lines + 0.45 * folds)
    density = BASE + np.maximum(melanin, 0)[:, None] * MELANIN + np.maximum(blood, 0.05)[:, None] * HAEMOGLOBIN
    density += (cords * 0.55 * np.exp(-1.2 * look.melanin))[:, None] * VEIN
    density += (0.10 * relief + look.creases * (0.14 * lines + 0.06 * folds))[:, None]
    if look.tattoo is not None:
        x, y = ((at.position[:, :2] - _TATTOO_CENTRE) / _TATTOO_RADIUS).T
        ink = tattoo(look.tattoo, -x, y) * smoothstep(-0.1, -0.4, at.facing) * (at.finger < 0)
        density += (ink * np.clip(0.85 + 0.08 * mottle, 0, 1))[:, None] * INK
    path = mean_free_path(melanin, blood) * (1 - 0.25 * joints * back)[:, None]  # little lies between skin and bone

    roughness = (
        look.roughness
        + 0.05 * (1 - at.hand)
        + 0.03 * mottle
        + 0.03 * blotches
        + 0.05 * palm
        + 0.05 * relief
        - 0.02 * joints * back
    )
    displacement = -look.creases * (3.2e-4 * lines + 2.2e-4 * folds) + 2.5e-4 * cords * back
    displacement += 2.0e-4 * tendons(at, hand.template.points[[hand.joint_names.index(f"{f}1") for f in FOUR]])
    displacement += 2.5e-5 * noise.field(at.position, 0.005) * (0.3 + 0.7 * at.hand)
    bump = (-3.0e-5 * relief - look.creases * 4e-5 * (lines + folds) + 4e-6 * mottle) * (nail > 1)
    plate = smoothstep(1.02, 0.96, nail)[:, None]
    path = path * (1 - plate) + (look.polish is None) * _NAIL_PATH * plate
    return _textures(at, *_with_nails(at, look, nail, np.exp(-density), roughness, displacement, noise), bump, path)


def _tone(look: SkinLook) -> float:
    """Units of melanin on the back of the hand."""
    return 5.8 * look.melanin**1.45


def _below_wrist(at: Places) -> Array:
    """1 on the hand, 0 on the forearm, fading over the wrist lines."""
    return smoothstep(-0.026, 0.012, at.position[:, 1])


def _relief(at: Places, noise: Noise, palm: Array) -> Array:
    """Fine criss-cross furrows (N,), 1 in a furrow and 0 on the plateaus; weaker on palm and forearm."""
    crossed = np.minimum(np.abs(noise.field(at.position, 0.0011)), np.abs(noise.field(at.position, 0.0014)))
    return np.exp(-((crossed / 0.22) ** 2)) * (1 - 0.45 * palm) * (0.35 + 0.65 * at.hand)


def _joints(at: Places) -> Array:
    """1 on the back of every finger joint, fading over a centimetre."""
    near = np.zeros(len(at.along))
    for f, knuckles in enumerate(at.knuckles):
        on = at.finger == f
        for joint, reach, weight in zip(knuckles[:3], (8e-3, 6.5e-3, 5e-3), (0.75, 1.0, 0.7), strict=True):
            spread = np.exp(-(((at.along[on] - joint) / reach) ** 2) - (at.across[on] / (1.5 * reach)) ** 2)
            near[on] = np.maximum(near[on], weight * spread)
    return near


def _pads(at: Places) -> Array:
    """1 on the finger tips, thenar and hypothenar: where palms are reddest."""
    tips = np.zeros(len(at.along))
    for f, knuckles in enumerate(at.knuckles):
        on = at.finger == f
        tips[on] = smoothstep(knuckles[2] + 2e-3, knuckles[3] - 4e-3, at.along[on])
    thenar = np.exp(-(((at.position[:, 0] - 0.024) / 0.014) ** 2 + ((at.position[:, 1] - 0.042) / 0.02) ** 2))
    hypothenar = np.exp(-(((at.position[:, 0] + 0.027) / 0.011) ** 2 + ((at.position[:, 1] - 0.035) / 0.022) ** 2))
    heads = np.exp(-(((at.position[:, 1] - 0.083) / 0.009) ** 2)) * (at.finger < 0)
    return np.maximum.reduce([tips, 0.8 * thenar, 0.8 * hypothenar, 0.6 * heads])


def _freckles(at: Places, noise: Noise, look: SkinLook) -> Array:
    if look.freckles == 0:
        return np.zeros(len(at.position))
    spots = smoothstep(1.4, 2.2, noise.field(at.position, 0.0013) + 0.4 * noise.field(at.position, 0.02))
    return 0.7 * look.freckles * (1 - 0.6 * look.melanin) * spots


def _moles(at: Places, rng: np.random.Generator) -> Array:
    """A few dark round spots on the back of the hand and the forearm."""
    total = np.zeros(len(at.position))
    back = np.flatnonzero((at.facing < -0.3) & (at.nail < 0.01))
    for centre in rng.choice(back, rng.integers(2, 6)):
        radius = rng.uniform(0.5e-3, 1.2e-3)
        distance = np.linalg.norm(at.position - at.position[centre], axis=1)
        total += rng.uniform(0.8, 2.0) * smoothstep(1.3 * radius, 0.6 * radius, distance)
    return total


def _nail(at: Places) -> Array:
    """Distance of a kind from the middle of the nail: below 1 on the plate; 9 where there is no nail near."""
    shape = (np.abs(at.nail_along) ** 3.2 + np.abs(at.nail_across) ** 3.2) ** (1 / 3.2)
    return np.where((at.facing < 0.25) & (shape > 0) & (at.nail_along > -2), shape, 9.0)


def _with_nails(
    at: Places, look: SkinLook, nail: Array, albedo: Array, roughness: Array, displacement: Array, noise: Noise
) -> tuple[Array, Array, Array]:
    """Skin with nails: pink plate, pale lunula and free edge, folds around; or polish."""
    plate = smoothstep(1.02, 0.96, nail)
    fold = np.exp(-(((nail - 1.04) / 0.07) ** 2))
    root = at.nail_along + 0.22 * at.nail_across**2
    lunula = smoothstep(-0.48, -0.62, root)
    free = smoothstep(0.72, 0.80, at.nail_along + 0.12 * at.nail_across**2)
    on = plate > 0
    ridges = np.zeros(len(plate))
    ridges[on] = noise.field(np.stack([at.nail_across, at.finger, 0 * root], axis=1)[on], (0.125, 1.0, 1.0))
    tone = _tone(look)
    blood = look.haemoglobin * (1.05 - 0.5 * lunula) * (1 - free) + 0.12
    density = BASE * (1.1 - 0.25 * lunula - 0.35 * free)[:, None] + (0.05 + 0.36 * tone) * MELANIN
    bare = np.exp(-density - blood[:, None] * HAEMOGLOBIN - 0.02 * ridges[:, None])
    gloss = np.full(len(albedo), 0.30)
    if look.polish is not None:
        bare = np.broadcast_to(np.asarray(look.polish), bare.shape)
        gloss = np.full(len(albedo), 0.12)
    shade = np.exp(-fold[:, None] * (0.25 * HAEMOGLOBIN + 0.12))
    albedo = albedo * shade * (1 - plate[:, None]) + bare * plate[:, None]
    roughness = roughness * (1 - plate) + gloss * plate
    displacement = displacement * (1 - plate) + 1.0e-4 * plate - 1.5e-4 * fold
    return albedo, np.clip(roughness, 0.08, 1.0), displacement


def _textures(at: Places, albedo: Array, roughness: Array, displacement: Array, bump: Array, path: Array) -> Skin:
    flat = np.stack([*albedo.T, *path.T, roughness, displacement, bump])
    maps = at.atlas.dilate(at.atlas.scatter(torch.from_numpy(np.ascontiguousarray(flat, np.float32)))).numpy()
    colour, paths = (np.ascontiguousarray(np.moveaxis(m, 0, 2)) for m in (maps[:3], maps[3:6]))
    return Skin(colour, maps[6], maps[7], maps[8], paths)
