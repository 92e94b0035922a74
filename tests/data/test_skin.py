"""Procedural skin: values, tones, anatomy and repeatability."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
import scipy.stats

from handbench.data.openstage.nails import NailLook
from handbench.data.openstage.people import SEEN_TATTOOS, look, tone_of
from handbench.data.openstage.places import places
from handbench.data.openstage.skin import Skin, SkinLook, make_skin
from handbench.data.openstage.tattoo import HELD_OUT, TATTOOS, Tattoo
from handbench.errors import InputError
from handbench.hand.openhand import OpenHand

SIZE = 192
HAND = OpenHand.load()


@cache
def skin(melanin: float = 0.3, **details: object) -> Skin:
    """Most tests compare with the same bare skin: made once, and nobody changes it."""
    return make_skin(HAND, HAND.neutral(), SkinLook(melanin, **details), SIZE)  # type: ignore[arg-type]


def flat(texture: np.ndarray) -> np.ndarray:
    """The covered texels of a texture."""
    return texture.reshape(SIZE * SIZE, -1)[places(HAND, SIZE).atlas.texels]


@pytest.mark.parametrize("melanin", [0.0, 0.5, 1.0])
def test_textures_are_physical(melanin: float) -> None:
    made = skin(melanin, tattoos=(Tattoo("star"),), freckles=1.0, spots=0.5, hair=1.0, birthmarks=2, scars=5)
    assert made.albedo.shape == (SIZE, SIZE, 3)
    assert made.roughness.shape == made.displacement.shape == (SIZE, SIZE)
    assert {made.albedo.dtype, made.roughness.dtype, made.displacement.dtype} == {np.dtype(np.float32)}
    assert made.albedo.min() > 0.001 and made.albedo.max() < 0.9
    assert made.roughness.min() > 0.05 and made.roughness.max() < 0.8
    assert -8e-4 < made.displacement.min() < -1.5e-4 and made.displacement.max() < 8e-4


def test_melanin_darkens_and_red_stays_strongest() -> None:
    back = places(HAND, SIZE).facing < -0.5
    means = np.array([flat(skin(m).albedo)[back].mean(axis=0) for m in (0.0, 0.25, 0.5, 0.75, 1.0)])
    assert (np.diff(means, axis=0) < 0).all()
    assert (means[:, 0] > means[:, 1]).all() and (means[:, 1] > means[:, 2]).all()
    assert means[0, 0] > 0.65 and means[-1, 0] < 0.2


def test_palms_of_dark_hands_are_lighter() -> None:
    at = places(HAND, SIZE)
    hand = (at.position[:, 1] > 0.02) & (at.nail < 0.01)
    albedo = flat(skin(0.9).albedo).mean(axis=1)
    assert albedo[hand & (at.facing > 0.6)].mean() > 1.8 * albedo[hand & (at.facing < -0.6)].mean()


def test_same_look_same_skin_other_seed_other_skin() -> None:
    first, again, other = skin(seed=4), skin.__wrapped__(seed=4), skin(seed=5)
    for field in dataclasses.fields(Skin):
        np.testing.assert_array_equal(getattr(first, field.name), getattr(again, field.name))
    assert np.abs(first.albedo - other.albedo).mean() > 0.003


def test_creases_lie_at_the_finger_joints() -> None:
    """On the palm side of the fingers, what creases take off the surface lies at the joints."""
    at = places(HAND, SIZE)
    depth = flat(skin(creases=1.0).displacement - skin(creases=0.0).displacement)[:, 0]
    for finger in range(1, 5):
        palm_side = (at.finger == finger) & (at.facing > 0.6)
        middle, end = at.knuckles[finger, 1:3]
        at_joint = palm_side & ((np.abs(at.along - middle) < 2e-3) | (np.abs(at.along - end) < 1e-3))
        between = palm_side & (np.abs(at.along - (middle + end) / 2) < 3e-3)
        assert depth[at_joint].mean() < -3e-5 < -1e-5 < depth[between].mean()


def test_smooth_hand_has_no_creases() -> None:
    depth = flat(skin(creases=0.0).displacement)[:, 0]
    at = places(HAND, SIZE)
    assert depth[(at.facing > 0.5) & (at.nail < 0.01)].min() > -3e-4
    assert depth.min() > flat(skin(creases=1.0).displacement).min() - 1e-9


def test_polish_colours_the_nails_only() -> None:
    at = places(HAND, SIZE)
    bare, painted = skin(), skin(nails=NailLook(polish=(0.4, 0.01, 0.02)))
    changed = np.abs(flat(bare.albedo) - flat(painted.albedo)).max(axis=1) > 0.02
    middle = at.nail > 0.9
    assert changed[middle].mean() > 0.95
    assert not changed[at.nail < 1e-6].any()
    np.testing.assert_allclose(flat(painted.albedo)[middle & changed].min(axis=0), [0.4, 0.01, 0.02], atol=0.25)
    assert flat(painted.roughness)[middle].mean() < 0.2 < flat(bare.roughness)[middle].mean()
    for finger in range(5):
        assert changed[at.finger == finger].sum() > 10


@pytest.mark.parametrize("name", sorted(TATTOOS))
def test_tattoos_darken_the_back_of_the_hand_only(name: str) -> None:
    at = places(HAND, SIZE)
    darker = flat(skin().albedo).sum(axis=1) - flat(skin(tattoos=(Tattoo(name),)).albedo).sum(axis=1)
    inked = darker > 0.1
    assert 60 < inked.sum() < 0.2 * len(inked)
    assert (at.facing[inked] < 0).all() and (at.finger[inked] < 0).all()
    assert darker.min() > -1e-6


def test_unknown_tattoo_is_refused_with_a_hint() -> None:
    with pytest.raises(InputError, match="star"):
        skin(tattoos=(Tattoo("stat"),))


def test_seams_do_not_show() -> None:
    """A vertex on a UV seam has the same colour on both sides, up to a texel's variation."""
    topology = HAND.topology(2)
    made = skin(0.5, creases=0.0, freckles=0.0)
    column = np.clip((topology.uvs[:, 0] * SIZE).astype(int), 0, SIZE - 1)
    row = np.clip(((1 - topology.uvs[:, 1]) * SIZE).astype(int), 0, SIZE - 1)
    colour = made.albedo[row, column].mean(axis=1)
    vertex, uv = np.unique(np.stack([topology.faces.ravel(), topology.uv_faces.ravel()]), axis=1)
    order = np.argsort(vertex, kind="stable")
    same = np.flatnonzero(np.diff(vertex[order]) == 0)
    assert len(same) > 100
    difference = np.abs(colour[uv[order[same]]] - colour[uv[order[same + 1]]])
    assert np.median(difference) < 0.5 * colour.std()


def test_fair_skin_scatters_as_jensen_measured_and_dark_skin_less_far() -> None:
    back = (places(HAND, SIZE).facing < -0.5) & (places(HAND, SIZE).nail < 1e-6)
    fair, dark = (1e3 * np.median(flat(skin(m).mean_free_path)[back], axis=0) for m in (0.15, 1.0))
    np.testing.assert_allclose(fair, [3.7, 1.4, 0.7], rtol=0.1)
    assert (0.35 * fair < dark).all() and (dark < 0.75 * fair).all()


def test_nothing_scatters_under_polish() -> None:
    middle = places(HAND, SIZE).nail > 0.9
    bare, painted = skin(), skin(nails=NailLook(polish=(0.4, 0.01, 0.02)))
    on = middle & (flat(painted.albedo)[:, 0] > 5 * flat(painted.albedo)[:, 1])
    assert on.sum() > 25
    assert flat(painted.mean_free_path)[on].max() < 5e-5 < 4e-4 < flat(bare.mean_free_path)[on].min()
    assert flat(painted.mean_free_path)[places(HAND, SIZE).nail < 1e-6].min() > 1e-4


def test_hardly_any_hair_is_none() -> None:
    none, least = (skin(hair=amount, seed=2).albedo for amount in (0.0, 1e-4))
    np.testing.assert_array_equal(none, least)


def test_hair_covers_the_arm_and_the_back_but_no_palm() -> None:
    at = places(HAND, SIZE)
    bare, hairy = (flat(skin(hair=amount, seed=2).albedo).mean(axis=1) for amount in (0.0, 1.0))
    darker = (bare - hairy) / bare
    arm, palm = (at.position[:, 1] < -0.04) & (at.facing < -0.3), (at.position[:, 1] > 0.02) & (at.facing > 0.5)
    assert darker[arm].mean() > 0.04 > 1e-6 > np.abs(darker[palm]).max()
    middle, knuckle = (np.abs(at.along / at.knuckles[at.finger, 1] - place) < 0.1 for place in (0.55, 1.0))
    finger = (at.finger > 0) & (at.facing < -0.4)
    assert darker[finger & middle].mean() > 2 * darker[finger & knuckle].mean()


def test_sun_does_not_reach_under_ring_and_sleeve() -> None:
    at = places(HAND, SIZE)
    tanned, worn = (flat(skin(tan=1.0, **kept).albedo).mean(axis=1) for kept in ({}, {"ring": 3, "sleeve": -0.03}))
    paler = worn > 1.03 * tanned
    assert paler[(at.position[:, 1] < -0.05) & (at.facing < -0.5)].mean() > 0.95
    assert set(at.finger[paler & (at.position[:, 1] > 0)]) == {3}


def test_tones_of_people_in_a_row_are_spread_from_very_light_to_very_dark() -> None:
    tones = np.sort([tone_of(i) for i in range(63)])
    np.testing.assert_allclose(tones, scipy.stats.beta(2, 2).ppf(np.arange(1, 64) / 64), atol=1e-6)
    assert min(tone_of(i) for i in range(8)) < 0.2 and max(tone_of(i) for i in range(8)) > 0.75


def test_somebody_is_the_same_person_again_and_wears_what_is_allowed() -> None:
    assert look(7) == look(7) != look(8)
    other = look(7, melanin=0.9)
    follow = {"melanin": 0.9, "freckles": other.freckles, "hair_colour": other.hair_colour}
    assert other == dataclasses.replace(look(7, melanin=0.1), **follow)
    names = {one.name for i in range(80) for one in look(i).tattoos}
    assert names == set(SEEN_TATTOOS) and not names & set(HELD_OUT)
    assert {one.name for i in range(80) for one in look(i, tattoos=HELD_OUT).tattoos} == set(HELD_OUT)


def test_people_differ_by_more_than_their_tone() -> None:
    """Five principal components leave more than a twelfth of what differs among people (benchmarks/skins.py)."""
    size = 64
    covered = places(HAND, size).atlas.covered
    people = np.stack([make_skin(HAND, HAND.neutral(), look(i), size).albedo[covered].ravel() for i in range(24)])
    power = np.linalg.svd(people - people.mean(axis=0), compute_uv=False) ** 2
    assert power[:5].sum() < 0.92 * power.sum()
