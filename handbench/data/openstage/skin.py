"""Procedural skin: the textures of a person, drawn by anatomy, pigments and what marks that person.

Colour is mixed as optical density, -log albedo = base + melanin + haemoglobin, so tones from very light to very
dark come from two pigments (after Tsumura et al., "Image-based skin color and texture analysis/synthesis", 2003).
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field

import numpy as np
import torch

from ...hand.openhand import Identity, OpenHand
from ...hand.openhand.template import FINGERS
from ...scene import Array
from . import marks
from .creases import finger_lines, knuckle_folds, palm_lines
from .hair import hair
from .nails import NailLook, Nails, nails
from .noise import Bands, NoiseFields
from .places import Places, places, smoothstep
from .regions import near_joints, pads, warm_fingers, webs
from .relief import furrows, pores, ridges
from .tattoo import Tattoo, inked
from .translucency import NAIL_PATH, mean_free_path
from .veins import tendons, veins


@dataclass(frozen=True)
class SkinLook:
    """How a person's skin looks; what is not said here is drawn by `seed`.

    melanin 0 (very light) … 1 (very dark). About 0 … 1: haemoglobin, warmth (yellow of the fat beneath), freckles,
    creases (lines, folds and furrows), veins, mottling (uneven redness), spots (of age), joints (how dark they are),
    tan, hair. hair_colour: linear RGB. roughness about 0.4. birthmarks, bleached (patches that lost their pigment)
    and scars: how many. sleeve: height y in metres on the neutral hand above which the sun came. ring: the finger
    (0 thumb … 4 little) or None. watch: whether one kept the sun off.
    """

    melanin: float
    haemoglobin: float = 0.5
    warmth: float = 0.3
    freckles: float = 0.2
    creases: float = 1.0
    roughness: float = 0.4
    veins: float = 0.6
    mottling: float = 0.6
    spots: float = 0.0
    joints: float = 0.6
    tan: float = 0.2
    hair: float = 0.2
    hair_colour: tuple[float, float, float] = (0.022, 0.013, 0.008)
    birthmarks: int = 0
    bleached: int = 0
    scars: int = 1
    sleeve: float | None = None
    ring: int | None = None
    watch: bool = False
    nails: NailLook = field(default_factory=NailLook)
    tattoos: tuple[Tattoo, ...] = ()
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
BASE = np.array([0.17, 0.36, 0.66], np.float32)
MELANIN = np.array([0.42, 0.57, 0.74], np.float32)
HAEMOGLOBIN = np.array([0.09, 0.55, 0.48], np.float32)
CAROTENE = np.array([0.0, 0.05, 0.28], np.float32)
VEIN = np.array([0.40, 0.15, 0.0], np.float32)
_FLOOR = np.float32(0.006)  # what the horny layer returns before any pigment
INK = np.array([1.75, 1.5, 1.2], np.float32)


@dataclass(frozen=True, eq=False)
class _Relief:
    """What is drawn once and shows in colour as well as in relief, per texel (N,): `skin.py`'s vocabulary."""

    palm: Array
    lines: Array
    folds: Array
    cords: Array
    furrows: Array
    pores: Array
    scars: Array
    joints: Array
    strands: Array
    nails: Nails


@dataclass(frozen=True)
class _Draws:
    """Random numbers of one person, for each part of the skin its own: more of one part changes no other."""

    seed: int

    def rng(self, part: str) -> np.random.Generator:
        return np.random.default_rng([self.seed, zlib.crc32(part.encode())])

    def noise(self, part: str) -> NoiseFields:
        return NoiseFields(int(self.rng(part).integers(2**62)))


def make_skin(hand: OpenHand, identity: Identity, look: SkinLook, size: int = 1024) -> Skin:
    """The textures (size, size) of a person; the same look gives the same textures.

    They are drawn on the neutral hand, whose UVs all identities share: `identity` stretches them with its surface
    and changes no texel. Raises `InputError` for an unknown tattoo.
    """
    at, draws = places(hand, size), _Draws(look.seed)
    bands = Bands.of(at.position, draws.noise("bands"))
    seen = _relief(at, look, draws, bands)
    albedo, path = _colour(at, look, draws, bands, seen)
    bones = hand.template.points[[hand.joint_names.index(f"{finger}1") for finger in FINGERS[1:]]]
    displacement, bump = _shape(at, look, draws, bands, seen, bones)
    roughness = _roughness(at, look, bands, seen)
    flat = np.stack([*albedo.T, *path.T, roughness, displacement, bump]).astype(np.float32, copy=False)
    maps = at.atlas.dilate(at.atlas.scatter(torch.from_numpy(flat))).numpy()
    colour, paths = (np.ascontiguousarray(np.moveaxis(m, 0, 2)) for m in (maps[:3], maps[3:6]))
    return Skin(colour, maps[6], maps[7], maps[8], paths)


def _relief(at: Places, look: SkinLook, draws: _Draws, bands: Bands) -> _Relief:
    palm = smoothstep(-0.25, 0.35, at.facing + 0.08 * bands.mm6[1]) * smoothstep(-0.026, 0.012, at.position[:, 1])
    palms = palm_lines(at, draws.noise("palm lines"), draws.rng("palm lines"))
    fingers = finger_lines(at, draws.noise("finger lines"), draws.rng("finger lines"))
    bare = np.zeros(len(palm), np.float32)
    return _Relief(
        palm,
        np.maximum(palms, fingers),
        knuckle_folds(at, draws.noise("folds"), draws.rng("folds")),
        veins(at, bands, draws.rng("veins")),
        furrows(at, bands, palm),
        pores(at, draws.noise("pores"), palm),
        marks.scars(at, draws.rng("scars"), look.scars) if look.scars else bare,
        near_joints(at, draws.rng("joints")),
        hair(at, look.hair, draws.rng("hair")) if look.hair else bare,
        nails(at, look.nails, draws.noise("nails")),
    )


def tone(melanin: float) -> float:
    """Units of melanin on the back of the hand, from 0 … 1."""
    return float(5.8 * melanin**1.45)


def _colour(at: Places, look: SkinLook, draws: _Draws, bands: Bands, seen: _Relief) -> tuple[Array, Array]:
    """Albedo (N, 3) and mean free path (N, 3)."""
    melanin, blood = _melanin(at, look, draws, bands, seen), _blood(at, look, draws, bands, seen)
    yellow = (0.3 + 0.7 * look.warmth) * (0.7 + 0.5 * seen.palm + 0.15 * bands.mm26[3])
    density = melanin[:, None] * MELANIN + blood[:, None] * HAEMOGLOBIN
    density += BASE + yellow[:, None] * CAROTENE - 0.3 * CAROTENE
    density += (seen.cords * look.veins * np.float32(np.exp(-1.3 * look.melanin)))[:, None] * VEIN
    density += (0.05 * seen.furrows + 0.06 * seen.pores + look.creases * (0.16 * seen.lines + 0.10 * seen.folds))[
        :, None
    ]
    path = mean_free_path(melanin, blood)
    path *= (1 - 0.25 * seen.joints * (1 - seen.palm))[:, None]  # little lies between skin and bone
    if look.tattoos:
        ink = inked(at, look.tattoos) * (0.85 + 0.08 * bands.mm3[2])
        density += ink[:, None] * INK
        path *= 1 - 0.6 * ink[:, None]
    albedo = _FLOOR + (1 - _FLOOR) * np.exp(-density)
    albedo += seen.strands[:, None] * (np.array(look.hair_colour, np.float32) - albedo)
    return _nailed(look, seen.nails, albedo, path)


def _melanin(at: Places, look: SkinLook, draws: _Draws, bands: Bands, seen: _Relief) -> Array:
    full, back = tone(look.melanin), 1 - seen.palm
    slow, broad = bands.mm26[0] + 0.5 * bands.mm11[0], bands.mm11[1]
    fine, grain = 0.8 * bands.mm3[0] + 0.5 * bands.mm1[0], bands.fine[0]
    melanin = full * (1 - seen.palm * (0.35 + 0.30 * float(smoothstep(0.15, 0.6, np.asarray(look.melanin)))))
    uneven = 0.23 * slow + 0.13 * broad + (0.025 + 0.02 * back) * fine + 0.02 * grain
    dark = 0.10 + 0.5 * look.joints
    melanin *= 1 + uneven / (1 + 0.04 * full**2) + dark * seen.joints * back / (1 + 0.12 * full)
    sun = look.tan * (0.55 + 0.08 * full) * smoothstep(0.7, -0.4, at.facing + 0.4 * bands.mm26[3])
    if look.sleeve is not None:
        sun *= smoothstep(look.sleeve - 8e-3, look.sleeve + 8e-3, at.position[:, 1] + 3e-3 * broad)
    if look.watch:
        sun *= 1 - marks.watch(at, draws.rng("watch"))
    if look.ring is not None:
        worn = marks.ring(at, look.ring, bands)
        sun *= 1 - worn
        melanin *= 1 - 0.14 * worn
    melanin += sun
    melanin += look.creases * (
        (0.11 + 0.21 * full * (0.3 + 0.7 * seen.palm)) * seen.lines + (0.09 + 0.09 * full) * seen.folds
    )
    light = 1 - 0.75 * look.melanin  # on dark skin spots stand out less
    if look.freckles:
        melanin += 1.1 * look.freckles * light * back * marks.freckles(at, bands)
    if look.spots:
        melanin += 1.3 * light * marks.spots(at, bands, draws.rng("spots"), look.spots)
    melanin += 2.0 * marks.moles(at, draws.rng("moles")) * (0.6 + 0.4 * light)
    if look.birthmarks:
        born = marks.patches(at, bands, draws.rng("birthmarks"), look.birthmarks, 9e-3)
        melanin += (0.35 + 0.1 * full) * born
    if look.bleached:
        lost = marks.patches(at, bands, draws.rng("bleached"), look.bleached, 1.6e-2)
        melanin *= 1 - 0.92 * lost
    return np.maximum(melanin * (1 - 0.45 * seen.scars), 0)


def _blood(at: Places, look: SkinLook, draws: _Draws, bands: Bands, seen: _Relief) -> Array:
    """Haemoglobin (N,): more on finger tips, palms and joints, less on webs; mottled as vessels fill unevenly."""
    back = 1 - seen.palm
    slow, broad, fine = bands.mm26[1] + 0.5 * bands.mm11[2], bands.mm6[2], 0.8 * bands.mm3[1] + 0.5 * bands.mm1[1]
    uneven = look.mottling * (0.36 * slow + 0.24 * broad + (0.14 + 0.10 * seen.palm) * fine)
    uneven += 0.04 * bands.fine[1]
    share = 0.72 + 0.5 * seen.joints * back + seen.palm * (0.32 + 0.4 * pads(at)) - 0.2 * webs(at)
    share = (
        share * (1 + uneven + look.mottling * warm_fingers(at, draws.rng("fingers")))
        + look.creases * (0.4 * seen.lines + 0.4 * seen.folds)
        + 0.35 * seen.scars
    )
    return np.maximum(look.haemoglobin * share, 0.05)


def _nailed(look: SkinLook, nail: Nails, albedo: Array, path: Array) -> tuple[Array, Array]:
    """Colour and mean free path with nails: pink beds, pale lunula and free edge, folds around; or polish."""
    blood = look.haemoglobin * (1.0 + 0.5 * nail.band - 0.45 * nail.lunula) * (1 - nail.free) + 0.12
    full = tone(look.melanin)
    clear = 1.1 - 0.35 * nail.lunula - 0.25 * nail.free
    density = clear[:, None] * BASE + ((0.05 + 0.45 * full * (1 - 0.7 * nail.free))[:, None]) * MELANIN
    plate, painted = nail.plate[:, None], nail.painted[:, None]
    bed = np.exp(-density - blood[:, None] * HAEMOGLOBIN - 0.03 * nail.ridges[:, None])
    skin = albedo * np.exp(-nail.fold[:, None] * (0.35 * HAEMOGLOBIN + 0.16) - nail.rim[:, None] * (0.2 * HAEMOGLOBIN))
    skin += 0.35 * nail.cuticle[:, None] * (0.62 - skin) * (1 - 0.5 * look.melanin)
    albedo = skin + plate * (bed - skin)
    path = path + plate * (NAIL_PATH - path)
    if look.nails.polish is not None:
        albedo = albedo + painted * (np.array(look.nails.polish, np.float32) - albedo)
        path = path * (1 - painted)
    return albedo, path


def _shape(at: Places, look: SkinLook, draws: _Draws, bands: Bands, seen: _Relief, bones: Array) -> tuple[Array, Array]:
    """Displacement (N,) of the mesh and bump (N,): what is broad and what is fine of the relief."""
    nail, back = seen.nails, 1 - seen.palm
    skin = 1 - nail.plate
    displacement = -look.creases * (3.2e-4 * seen.lines + 2.0e-4 * seen.folds)
    displacement += 4.0e-4 * look.veins * seen.cords * back + 2.0e-4 * tendons(at, bones)
    displacement += 3.0e-5 * bands.mm6[3] * (0.3 + 0.7 * at.hand)
    displacement = displacement * skin + 1.0e-4 * nail.plate - 1.5e-4 * nail.fold + 1.2e-4 * nail.rim
    smooth = 1 - 0.7 * seen.scars
    bump = -smooth * ((2.5e-5 + 2.5e-5 * look.creases) * seen.furrows + 3.0e-5 * seen.pores)
    bump -= look.creases * (1.1e-4 * seen.lines + 1.1e-4 * seen.folds) + 5e-5 * seen.scars
    bump += 1.4e-5 * ridges(at, draws.noise("ridges"), seen.palm) * smooth + 2.0e-5 * seen.strands
    bump += 6e-6 * bands.mm3[3]
    bump = bump * skin + nail.plate * (1 - 0.7 * nail.painted) * 5e-6 * nail.ridges + 6e-5 * nail.free
    return displacement, bump + 2.5e-5 * nail.painted - 6e-5 * nail.fold


def _roughness(at: Places, look: SkinLook, bands: Bands, seen: _Relief) -> Array:
    """Of the sharper of two lobes: drier on the palm, oily in patches, smooth on nails."""
    nail = seen.nails
    rough = look.roughness + 0.03 * bands.mm11[1] + 0.02 * bands.mm6[0] + 0.025 * bands.mm3[1]
    rough += 0.05 * (1 - at.hand) + 0.04 * seen.palm + 0.06 * seen.furrows - 0.02 * seen.joints * (1 - seen.palm)
    gloss = 0.30 + 0.02 * nail.ridges + 0.08 * nail.free
    gloss += nail.painted * (0.12 - gloss)
    return np.clip(rough + nail.plate * (gloss - rough), 0.08, 1.0)
