"""Light is taken out of scans in unknown light: what each way recovers, and what it cannot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from othercamera import check_seen_by
from toyscan import LIGHT, SIZE, Scan, scan, skin

from handbench.errors import Unsupported
from handbench.methods.phone import mean as floor
from handbench.methods.phone import method as phone
from handbench.methods.phone.joint import decomposed, irradiance
from handbench.methods.phone.method import HARMONIC, PhoneConfig, PhonePrior
from handbench.methods.phone.shadow import LEAST, shadow
from handbench.methods.phone.unwrap import Unwrapped, unwrapped
from handbench.methods.phone.usual import Usual
from handbench.methods.reflectance.model import ReflectanceConfig, ReflectancePrior
from handbench.registry import METHODS
from handbench.scene import Array, Directional, Environment, Prediction, Unknown

DARK, LIGHT_SKINNED = (0.06, 0.25), (0.45, 0.5)
EVEN = np.eye(9)[:1].T * np.full(3, 2.0)


@pytest.fixture(scope="module")
def dark() -> Scan:
    return scan(skin(*DARK))


@pytest.fixture(scope="module")
def found(dark: Scan) -> Unwrapped:
    return unwrapped(dark.hand, dark.enrolment, SIZE)


def psnr(texture: Array, albedo: Array, seen: Array) -> float:
    """Of two textures (3, N) after the best factor in each channel, over their peak, as the eye sees it."""
    texture, albedo = texture[:, seen], albedo[:, seen]
    scaled = texture * ((texture * albedo).sum(1) / (texture**2).sum(1))[:, None]
    error = np.maximum(scaled, 0.0) ** (1 / 2.2) - albedo ** (1 / 2.2)
    return float(-10.0 * np.log10((error**2).mean()))


# --- light and albedo together ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("tones", [DARK, LIGHT_SKINNED])
def test_light_and_albedo_of_a_turning_hand_are_told_apart(tones: tuple[float, float]) -> None:
    made = scan(skin(*tones))
    found = unwrapped(made.hand, made.enrolment, SIZE)
    solved = decomposed(found.pictures, found.mean, found.foreground)
    before, after = (psnr(texture, made.albedo, found.seen) for texture in (found.mean, solved.colour))
    assert after > before + 1.0, (before, after)  # two more are lost to the pictures' pixels
    normals = np.concatenate([picture.normal[picture.weight > 0.3] for picture in found.pictures])
    true, told = irradiance(normals) @ LIGHT, solved.shading(normals).T
    assert all(np.corrcoef(true[:, c], told[:, c])[0, 1] > 0.9 for c in range(3))


def test_no_light_is_negative() -> None:
    lamp = np.linspace(0.0, 1.0, 9)[:, None] * np.full(3, 4.0)  # rings far below zero
    lamp[0] = 0.5
    made = scan(skin(0.3, 0.3), lamp.clip(0), turns=3)
    found = unwrapped(made.hand, made.enrolment, SIZE)
    solved = decomposed(found.pictures, found.mean, found.foreground, rounds=2)
    normals = np.random.default_rng(0).normal(size=(500, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert (irradiance(normals) @ solved.light > 0).all() and (solved.colour >= 0).all()


def test_a_single_picture_is_explained_by_a_hand_of_one_colour() -> None:
    made = scan(skin(0.3, 0.3), turns=1)
    found = unwrapped(made.hand, made.enrolment, SIZE)
    solved = decomposed(found.pictures, found.mean, found.foreground)
    before, after = (psnr(texture, made.albedo, found.seen) for texture in (found.mean, solved.colour))
    assert after > before + 6.0


# --- the seed's shadow ------------------------------------------------------------------------------------------------


def test_a_shadow_is_the_least_squares_solution(found: Unwrapped) -> None:
    atlas, rng = found.atlas, np.random.default_rng(0)
    texture, seen = rng.uniform(0.2, 0.4, (3, atlas.count)), rng.random(atlas.count) < 0.9
    colour = np.array([0.35, 0.3, 0.25])
    right, _, up, _ = (torch.from_numpy(np.asarray(other)) for other in atlas.neighbours(torch.device("cpu")))

    def cost(values: torch.Tensor) -> torch.Tensor:
        told = (values[None] * torch.from_numpy(colour)[:, None] - torch.from_numpy(texture)) ** 2
        data = told.sum(0)[torch.from_numpy(seen)].sum() / float(colour @ colour)
        steps = sum(((values - values[other]) ** 2).sum() for other in (right, up))
        return data + 3.0 * steps

    solved = torch.tensor(shadow(texture, seen, colour, atlas, 3.0), requires_grad=True)
    (gradient,) = torch.autograd.grad(cost(solved), solved)
    assert gradient.abs().max() < 1e-4 and solved.std() > 1e-3


def test_even_light_on_even_skin_leaves_the_texture_as_it_is(found: Unwrapped) -> None:
    texture = np.tile(found.foreground[:, None], (1, found.atlas.count))
    dark = shadow(texture, found.seen, found.foreground, found.atlas, 1.0)
    assert np.allclose(dark, 1.0, atol=1e-6)


def test_a_tattoo_stays_where_it_is_and_changes_little_around() -> None:
    plain, drawn = np.full((3, len(skin(0.4, 0.4)[0])), 0.4), np.full((3, len(skin(0.4, 0.4)[0])), 0.4)
    made = scan(plain, EVEN)
    atlas = made.hand.atlas(SIZE)
    row, column = atlas.texels // SIZE, atlas.texels % SIZE
    middle = np.argmax(np.bincount(atlas.chart))  # of the largest chart
    own = np.flatnonzero(atlas.chart == middle)
    centre = np.array([np.median(row[own]), np.median(column[own])])
    ink = (np.abs(row - centre[0]) < 2) & (np.abs(column - centre[1]) < 2)
    drawn[:, ink] = 0.08
    textures = []
    for albedo in (plain, drawn):
        found = unwrapped(made.hand, scan(albedo, EVEN).enrolment, SIZE)
        dark = shadow(found.mean, found.seen, found.foreground, atlas, 100.0)
        textures.append((found.mean / dark, found.seen))
    (before, seen), (after, _) = textures
    change = np.abs(after / before.clip(1e-6) - 1.0).mean(axis=0)
    far = seen & (np.hypot(row - centre[0], column - centre[1]) > 12)
    assert change[ink & seen].mean() > 0.5 and change[far].mean() < 0.05


def test_the_seeds_way_takes_a_light_palm_for_light_and_the_joint_one_does_not(dark: Scan, found: Unwrapped) -> None:
    solved = decomposed(found.pictures, found.mean, found.foreground)
    divided = found.mean / shadow(found.mean, found.seen, found.foreground, found.atlas, 10.0)
    palm = dark.albedo[0] > 0.2
    contrast = {
        name: colour[0, palm & found.seen].mean() / colour[0, (dark.albedo[0] < 0.1) & found.seen].mean()
        for name, colour in (("true", dark.albedo), ("joint", solved.colour), ("shadow", divided))
    }
    assert contrast["shadow"] < 0.5 * contrast["true"] < contrast["joint"] < 1.5 * contrast["true"]


def test_a_shadow_is_kept_in_its_bounds(found: Unwrapped) -> None:
    dark = shadow(found.mean, found.seen, found.foreground, found.atlas, 0.01, most=1.0)
    assert dark.min() >= LEAST and dark.max() == 1.0


# --- behind the one interface -----------------------------------------------------------------------------------------


JOINT = PhoneConfig(removal="joint")


def prior(config: PhoneConfig = JOINT) -> PhonePrior:
    inner = ReflectancePrior("physical", "brdf", ReflectanceConfig(texture=SIZE), (1.0, 0.3, 0.5))
    return PhonePrior(inner, Usual(2.0, torch.tensor([0.1, 0.08, 0.06])), HARMONIC, config, SIZE)


@pytest.fixture
def exact(dark: Scan, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (phone, floor):
        monkeypatch.setattr(module, "fitted_hand", lambda *_, **__: dark.hand)


def error(picture: Prediction, dark: Scan, number: int) -> float:
    seen = dark.enrolment.observe(dark.enrolment.frames[number])
    return float(np.abs(picture.image - seen.image).sum() / seen.image.sum())


def own(dark: Scan, number: int):
    frame, pose = dark.enrolment.frames[number], dark.hand.sightings[number].pose
    return replace(frame.query, pose=pose)


def test_under_its_own_light_it_is_nearer_than_the_mean(dark: Scan, exact: None) -> None:
    avatars = [one.personalise(dark.enrolment) for one in (prior(), floor.create().train(dark.enrolment))]
    joint, mean = (np.mean([error(a.relight(own(dark, i)), dark, i) for i in range(3)]) for a in avatars)
    assert joint < 0.5 * mean, (joint, mean)


def test_relit_it_is_linear_in_light_and_tells_its_mesh(dark: Scan, exact: None) -> None:
    avatar = prior().personalise(dark.enrolment)
    lights = Directional((0.0, 0.0, 1.0), (1.0, 2.0, 3.0)), Environment("even", np.ones((4, 8, 3), np.float32))
    posed = avatar.pose(own(dark, 0).viewpoint)
    for light in lights:
        once, thrice = posed.relight(light), posed.relight(light.scaled(3.0))
        assert np.allclose(3.0 * once.image, thrice.image, rtol=1e-4, atol=1e-6) and once.image.max() > 0
        assert np.array_equal(once.mesh.vertices, dark.hand.mesh(own(dark, 0).pose).vertices)


def test_another_camera_shares_the_pose(dark: Scan, exact: None) -> None:
    avatar = prior().personalise(dark.enrolment)
    for light in (own(dark, 0).light, Directional((0.0, 0.0, 1.0), (1.0, 2.0, 3.0))):
        check_seen_by(avatar, replace(own(dark, 0), light=light))


def test_what_is_assumed_decides_the_brightness(dark: Scan, exact: None) -> None:
    light = Directional((0.0, 0.0, 1.0), (1.0, 1.0, 1.0))

    def bright(usual: Usual, **config) -> float:
        one = prior(PhoneConfig(removal="joint", **config))
        one.usual = usual
        return float(one.personalise(dark.enrolment).pose(own(dark, 0).viewpoint).relight(light).image.mean())

    usual = prior().usual
    half, double = replace(usual, light=2 * usual.light), replace(usual, skin=2 * usual.skin)
    base = bright(usual)
    assert bright(half) < base and np.isclose(bright(double), base)
    assert bright(double, assumed="skin") > bright(usual, assumed="skin")


def test_a_prior_is_what_was_saved(dark: Scan, exact: None, tmp_path: Path) -> None:
    made = phone.create_harmonic("smoke")
    one = PhonePrior(
        ReflectancePrior("physical", "brdf", ReflectanceConfig(), (0.8, 0.2, 0.5)),
        Usual(1.7, torch.tensor([0.1, 0.2, 0.3])),
        HARMONIC,
        PhoneConfig(**made.config["phone"]),
        128,
    )
    one.save(tmp_path)
    again = made.load(tmp_path)
    assert again.usual.light == 1.7 and torch.equal(again.usual.skin, one.usual.skin)
    assert again.inner.diffuse == one.inner.diffuse


@pytest.mark.parametrize("removal", ["joint", "shadow"])
def test_an_avatar_is_what_was_kept(dark: Scan, exact: None, tmp_path: Path, removal: str) -> None:
    one = prior(PhoneConfig(removal=removal))
    avatar = one.personalise(dark.enrolment)
    avatar.save(tmp_path)
    again = one.restore(tmp_path)
    known = Environment("even", np.ones((4, 8, 3), np.float32))
    for light in (known, Unknown("own")) if removal == "joint" else (known,):
        first, second = (a.pose(own(dark, 0).viewpoint).relight(light) for a in (avatar, again))
        assert np.array_equal(first.image, second.image) and first.image.max() > 0
    assert list(avatar.found) == [sighting.frame.pose_key for sighting in dark.hand.sightings] and not again.found
    baked = again.baked(own(dark, 0).viewpoint)
    assert baked.specular == pytest.approx(0.3) and len(baked.mesh.vertices) == len(first.mesh.vertices)


@pytest.mark.parametrize("name", ["urhand-phone", "sh-phone", "mean-phone"])
def test_they_are_registered_and_need_no_light_and_no_mesh(name: str) -> None:
    made = METHODS.entry(name).load()(preset="smoke")
    assert made.info.name == name and made.info.needs == {"image", "alpha", "camera", "keypoints"}
    assert ("unknown" in made.info.lights) is (name != "urhand-phone")


def test_pictures_that_show_nothing_of_the_hand_are_a_reason(dark: Scan) -> None:
    away = replace(
        dark.hand,
        sightings=tuple(
            replace(one, pose=replace(one.pose, translation=(5.0, 0.0, 0.0))) for one in dark.hand.sightings
        ),
    )
    with pytest.raises(Unsupported, match="show nothing of the fitted hand"):
        unwrapped(away, dark.enrolment, SIZE)


def test_unknown_light_is_all_that_it_estimates(dark: Scan, exact: None) -> None:
    posed = prior().personalise(dark.enrolment).pose(own(dark, 0).viewpoint)
    assert np.array_equal(posed.relight(Unknown("a")).image, posed.relight(Unknown("b")).image)
    with pytest.raises(Unsupported, match="is not told"):
        prior(PhoneConfig()).personalise(dark.enrolment).pose(own(dark, 0).viewpoint).relight(Unknown("a"))
