"""HARP and the UHM-style adaptation: hands in a light that nobody measured, from pictures of a capture and of a toy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from othercamera import check_seen_by
from shadedtracer import Shaded

from handbench.bench.reader import CaptureReader
from handbench.bench.scoring import Scoring
from handbench.data.capture import Capture
from handbench.data.openstage import make as module
from handbench.data.openstage.capture import OpenCapture
from handbench.data.openstage.plans import production
from handbench.data.openstage.presets import PRESETS
from handbench.errors import InputError, Unsupported
from handbench.hand import hand_model
from handbench.hand.fitting import FittingSettings
from handbench.method import Avatar
from handbench.methods import harp, uhm
from handbench.methods.harp import method as harp_method
from handbench.methods.harp.config import PRESETS as HARP
from handbench.methods.harp.config import HarpConfig
from handbench.methods.harp.fitting import fitted
from handbench.methods.harp.look import Look, shade
from handbench.methods.harp.losses import jitter, upright
from handbench.methods.harp.method import HarpAvatar
from handbench.methods.harp.shadow import visibility
from handbench.methods.harp.start import lit_from
from handbench.methods.harp.surface import HandSurface, mapped
from handbench.methods.kit.albedo import Canvas, flat
from handbench.methods.kit.crop import Crop
from handbench.methods.kit.enrolled import Enrolled, PosedPicture, enrolled
from handbench.methods.uhm import method as uhm_method
from handbench.methods.uhm.adaptation import adapted
from handbench.methods.uhm.config import PRESETS as UHM
from handbench.methods.uhm.shading import Shadowing
from handbench.metrics import metric
from handbench.recording import Recording
from handbench.render.see.raster import rasterise
from handbench.render.uv.atlas import Atlas
from handbench.scene import (
    Array,
    Camera,
    Directional,
    Frame,
    Group,
    Mesh,
    Observation,
    Pose,
    Prediction,
    Query,
    Unknown,
)
from handbench.scene.colour import srgb

GIVES = frozenset({"image", "alpha", "camera", "keypoints", "pose"})


def silent(step: int, total: int, **values: float) -> None: ...


def decibels(image: Array, truth: Array) -> float:
    return float(-10 * np.log10(np.square(srgb(image) - srgb(truth)).mean()))


def overlap(alpha: Array, truth: Array) -> float:
    return float(np.minimum(alpha, truth).sum() / np.maximum(alpha, truth).sum())


# --- a capture: the smallest hand in the wild, drawn as a diffuse surface ---------------------------------------------


@pytest.fixture(scope="module")
def wild(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Capture]:
    folder = tmp_path_factory.mktemp("wild") / "openwild"
    small = replace(PRESETS["openwild"]["mini"], subjects=1, moments=3, later=1, every=3, height=96, width=72)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "PathTracer", Shaded)
        module.make(production(small), folder)
    yield OpenCapture(folder)


@pytest.fixture(scope="module")
def sequence(wild: Capture) -> Recording:
    return Recording([frame for frame in wild.frames() if frame.segment == "sequence"], wild.observe, GIVES)


@pytest.fixture(scope="module")
def avatars(sequence: Recording) -> dict[str, Avatar]:
    """Both, personalised as a bench does; the hand is fitted once for the two."""
    start = enrolled(sequence, 2, FittingSettings(starts=1, steps=10))
    with pytest.MonkeyPatch.context() as patch:
        for where in (harp_method, uhm_method):
            patch.setattr(where, "enrolled", lambda *_: start)
        made = {"harp": harp.create("smoke"), "uhm": uhm.create("smoke")}
        return {name: method.train(sequence).personalise(sequence) for name, method in made.items()}


@pytest.mark.parametrize("name", ["harp", "uhm"])
def test_later_frames_in_the_enrolled_light_are_nearer_than_the_mean_colour(
    name: str, wild: Capture, sequence: Recording, avatars: dict[str, Avatar]
) -> None:
    shown = [wild.observe(frame) for frame in wild.frames() if frame.segment == "sequence"]
    mean = np.concatenate([seen.image[seen.alpha > 0.99] for seen in shown]).mean(axis=0)
    for frame in (f for f in wild.frames() if f.segment == "later"):
        truth = wild.observe(frame)
        found = avatars[name].relight(asked(frame))
        assert overlap(found.alpha, truth.alpha) > 0.9
        assert decibels(found.image, truth.image) > decibels(found.alpha[..., None] * mean, truth.image) + 1.5


@pytest.mark.parametrize("name", ["harp", "uhm"])
def test_what_the_fit_found_of_the_hand_is_scored_against_the_true_hand(
    name: str, wild: Capture, avatars: dict[str, Avatar]
) -> None:
    frames = [frame for frame in wild.frames() if frame.segment == "later"]
    reader = CaptureReader(wild)
    scoring = Scoring(reader, {"surface-mean": metric("surface-mean")})
    scoring.score((frame, avatars[name].relight(asked(frame))) for frame in frames)
    values = [scored.values[0] for scored in scoring.frames([("later", frame) for frame in frames])]
    assert frames[0].mesh is None and all(value is not None and 0.05 < value < 6.0 for value in values), values  # mm
    for frame in frames:
        true = reader.surface(frame)
        assert true is not None and np.array_equal(true.vertices, wild.truth(frame).mesh.vertices)  # type: ignore[union-attr]


@pytest.mark.parametrize("name", ["harp", "uhm"])
def test_relighting_is_linear_in_known_light(name: str, wild: Capture, avatars: dict[str, Avatar]) -> None:
    assert {"harp": harp.create(), "uhm": uhm.create()}[name].info.linear
    frames = {frame.lighting: frame for frame in wild.frames() if frame.segment == "relit"}
    one, two = frames["lamp"], next(frame for key, frame in frames.items() if key != "lamp")
    posed = avatars[name].pose(one.viewpoint)
    both = posed.relight(Group((one.light.scaled(2.0), two.light.scaled(0.5)))).image
    expected = 2.0 * posed.relight(one.light).image + 0.5 * posed.relight(two.light).image
    assert expected.max() > 0.1 and np.abs(both - expected).max() < 1e-5 * expected.max()


@pytest.mark.parametrize("name", ["harp", "uhm"])
def test_unknown_light_among_others_is_refused(name: str, wild: Capture, avatars: dict[str, Avatar]) -> None:
    frame = wild.frames()[0]
    with pytest.raises(Unsupported, match="not told"):
        avatars[name].pose(frame.viewpoint).relight(Group((Unknown("as-enrolled"), Directional([0, 1, 0], [1, 1, 1]))))


def asked(frame: Frame) -> Any:
    return replace(frame.query, light=Unknown("as-enrolled"), lighting="as-enrolled")


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["harp", "uhm"])
@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"keypoints": np.zeros((21, 3))}, "no key points are given inside the picture"),
        ({"alpha": np.zeros((96, 72), np.float32)}, "the mask covers 0 pixels"),
        ({"keypoints": None}, "key points is not given"),
    ],
)
def test_what_cannot_be_fitted_is_unsupported_with_the_reason(
    name: str, change: dict[str, Any], reason: str, wild: Capture, sequence: Recording
) -> None:
    bad = Recording(sequence.frames, lambda frame: replace(sequence.observe(frame), **change), GIVES)
    method = {"harp": harp, "uhm": uhm}[name].create("smoke")
    with pytest.raises(Unsupported, match=reason):
        method.train(bad).personalise(bad)


@pytest.mark.parametrize("create", [harp.create, uhm.create])
def test_presets_and_priors(create: Any, tmp_path: Path) -> None:
    method = create("smoke")
    method.train(Recording((), lambda frame: None)).save(tmp_path)  # type: ignore[arg-type, return-value]
    assert method.load(tmp_path) is not None
    with pytest.raises(InputError, match="trained with"):
        create("quick").load(tmp_path)
    with pytest.raises(InputError, match="unknown preset"):
        create("swift")


def test_an_empty_mask_has_no_close_up() -> None:
    with pytest.raises(Unsupported, match="empty"):
        Crop.of(camera(), np.zeros((96, 72, 3), np.float32), np.zeros((96, 72), np.float32), 64)


def test_close_ups_see_what_the_camera_saw() -> None:
    whole = camera()
    alpha = np.zeros((96, 72), np.float32)
    alpha[31:80, 20:51] = 1.0
    crop = Crop.of(whole, np.repeat(alpha[..., None], 3, axis=2), alpha, 30)
    assert max(crop.alpha.shape) <= 30 and crop.alpha.shape == (crop.camera.height, crop.camera.width)
    point = whole.unproject(np.array([35.0, 60.0]), 0.4)
    place = crop.camera.project(point)[0]
    corner = crop.camera.project(whole.unproject(np.array([20.0, 31.0]), 0.4))[0]
    np.testing.assert_allclose(place - corner, np.array([15.0, 29.0]) / 2)
    assert abs(4 * crop.alpha.sum() - alpha.sum()) < 1e-3


# --- a toy: a hand that is plumper than its model says, in HARP's own light -------------------------------------------

LIGHT, AMBIENT, PLUMP = np.array([-0.5, 0.6, 0.7]), 0.3, 2e-3


def camera(width: int = 72, height: int = 96) -> Camera:
    K = np.array([[1.5 * height, 0, width / 2], [0, 1.5 * height, height / 2], [0, 0, 1]])
    return Camera("front", width, height, K, np.c_[np.diag([1.0, -1.0, -1.0]), [0.0, 0.06, 0.4]])


@pytest.fixture(scope="module")
def toy() -> tuple[Enrolled, torch.Tensor]:
    """Two exact poses of a hand that is not exact, with stripes, and the true albedo (3, N)."""
    hand = hand_model()
    shape, surface = np.asarray(hand.neutral()), HandSurface(hand, 1)
    atlas = Atlas.of(surface.topology, 64)
    height = torch.from_numpy(atlas.interpolate(hand.rest_position(1))[:, 1])
    stripes = torch.tensor([0.5, 0.3, 0.2])[:, None] * (1.0 + 0.4 * torch.sign(torch.sin(120.0 * height)))
    albedo = atlas.dilate(atlas.scatter(stripes.float()))
    seen = []
    for angle in (-0.3, 0.3):
        pose = Pose(hand.named_pose("rest").joints, [0.0, angle, 0.0])
        given = [torch.tensor(np.asarray(part)) for part in (shape, pose.joints, pose.rotation, pose.translation)]
        vertices = surface.posed(*given, torch.full((surface.count,), PLUMP).double())  # type: ignore[call-arg]
        canvas = Canvas(Mesh(vertices.numpy(), surface.topology), camera(), 64)
        points = canvas.position.T.double().numpy()
        visible = torch.from_numpy(visibility(canvas.surface.mesh, LIGHT, points, 128)).float()
        light, raw = torch.from_numpy(LIGHT).float(), torch.tensor(np.log(AMBIENT / (1 - AMBIENT))).float()
        drawn = canvas.drawn(flat(albedo, canvas) * shade(canvas.position.T, canvas.normal.T, visible, light, raw))
        seen.append(PosedPicture("me/pose", camera(), Observation(drawn.image, drawn.alpha), pose))
    return Enrolled(hand, shape, tuple(seen)), stripes


CONFIG = replace(HARP["smoke"], steps=(10, 6, 20), side=96, rate=4e-4)


@pytest.fixture(scope="module")
def look(toy: tuple[Enrolled, torch.Tensor]) -> Look:
    return fitted(toy[0], CONFIG, 0, silent)


def test_displacements_bring_the_outline_to_the_mask(toy: tuple[Enrolled, torch.Tensor], look: Look) -> None:
    for seen in toy[0].pictures:
        before, after = (
            overlap(rasterise(mesh, seen.camera).alpha, seen.observation.alpha)  # type: ignore[arg-type]
            for mesh in (toy[0].mesh(seen.pose, 1), look.mesh(seen.pose))
        )
        assert after > before + 0.3 * (1.0 - before), (before, after)
    assert float(look.offset.mean()) > 0.1 * PLUMP


def test_another_camera_shares_harps_pose(toy: tuple[Enrolled, torch.Tensor], look: Look) -> None:
    pose = toy[0].pictures[0].pose
    for light in (Unknown("as enrolled"), Directional((0.48, 0.36, 0.8), (1.0, 1.0, 1.0))):
        check_seen_by(HarpAvatar(look), Query("me", "pose", "light", pose, None, camera(), light))


def test_albedo_and_light_are_found_in_harps_own_light(toy: tuple[Enrolled, torch.Tensor], look: Look) -> None:
    start, stripes = toy
    # hands that face the camera hardly tell light from behind it from ambient light, so only the rest is compared
    across, true_across = look.light.numpy()[:2], LIGHT[:2]
    cosine = across @ true_across / np.linalg.norm(across) / np.linalg.norm(true_across)
    assert cosine > np.cos(np.radians(25))
    atlas = Atlas.of(look.surface.topology, look.config.texture)
    canvas = Canvas(look.mesh(start.pictures[0].pose), camera(), look.config.texture)
    inside = torch.from_numpy(canvas.texels)[canvas.normal[2] > 0.7]
    found, true = atlas.gather(look.albedo)[:, inside], stripes[:, inside]
    ratio = found / true
    assert 0.75 < float(ratio.median()) < 1.45
    assert np.corrcoef(found[1].numpy(), true[1].numpy())[0, 1] > 0.6
    flat_colour = true.mean(dim=1, keepdim=True)
    assert float((found / ratio.median() - true).abs().mean()) < 0.8 * float((flat_colour - true).abs().mean())


def test_avatars_are_what_was_kept(toy: tuple[Enrolled, torch.Tensor], look: Look, tmp_path: Path) -> None:
    person = adapted(toy[0], replace(UHM["smoke"], shadow_steps=1, refine_steps=1), 0, silent)
    kept = {
        "harp": (harp_method.HarpAvatar(look, toy[0].found), lambda at: harp_method.HarpAvatar.load(at, look.config)),
        "uhm": (uhm_method.UhmAvatar(person), lambda at: uhm_method.UhmAvatar.load(at, person.config)),
    }
    pose = toy[0].pictures[0].pose
    for name, (avatar, load) in kept.items():
        (tmp_path / name).mkdir()
        avatar.save(tmp_path / name)
        again = load(tmp_path / name)
        for light in (Directional([0.0, 0.0, 1.0], [1.0, 1.0, 1.0]), Unknown("own")):
            frame = Frame("s", "m", "own", pose, None, camera(), light, "sequence", "environment")
            first, second = avatar.relight(frame.query), again.relight(frame.query)
            assert np.array_equal(first.image, second.image) and first.image.max() > 0.01, name
        baked = again.baked(frame.viewpoint)
        assert baked.albedo.max() > 0.05 and (baked.normal is None) is (name == "uhm")
        assert avatar.found == {"me/pose": toy[0].pictures[1].pose}
    with pytest.raises(InputError, match="trained with"):
        uhm_method.UhmAvatar.load(tmp_path / "uhm", replace(person.config, gloss=0.4))


def test_the_same_seed_gives_the_same_answer(toy: tuple[Enrolled, torch.Tensor]) -> None:
    short = replace(CONFIG, steps=(1, 1, 2))
    one, two = (fitted(toy[0], short, 3, silent) for _ in range(2))
    for name in ("offset", "albedo", "normal_map", "light"):
        assert torch.equal(getattr(one, name), getattr(two, name)), name
    brief = replace(UHM["smoke"], shadow_steps=2, refine_steps=2)
    first, second = (adapted(toy[0], brief, 3, silent) for _ in range(2))
    assert torch.equal(first.texture, second.texture) and torch.equal(first.shadows, second.shadows)


def test_one_picture_is_enough_and_the_released_settings_run(toy: tuple[Enrolled, torch.Tensor]) -> None:
    single = replace(toy[0], pictures=toy[0].pictures[:1])
    released = replace(HARP["released"], side=48, texture=32, shadow_size=48, steps=(1, 1, 1))
    query = camera()
    for config in (released, replace(CONFIG, steps=(1, 1, 1))):
        found = draw(fitted(single, config, 0, silent), single.pictures[0].pose, query)
        assert np.isfinite(found.image).all() and found.image.max() > 0.05


def draw(look: Look, pose: Pose, view: Camera) -> Prediction:
    frame = Frame("s", "m", "own", pose, None, view, Unknown("own"), "sequence", "environment")
    return harp_method.HarpAvatar(look).relight(frame.query)


def test_textures_of_the_released_uhm_hardly_move(toy: tuple[Enrolled, torch.Tensor]) -> None:
    brief = replace(UHM["smoke"], shadow_steps=1, refine_steps=5)
    still, released, intended = (
        adapted(toy[0], replace(brief, refine_steps=steps, refine_rate=rate), 0, silent).texture
        for steps, rate in ((0, 0.0), (5, UHM["released"].refine_rate), (5, UHM["paper"].refine_rate))
    )
    assert 0 < float((released - still).abs().max()) < 1e-4 < float((intended - still).abs().max())


def test_uhm_shadows_are_as_smooth_as_they_are_told(toy: tuple[Enrolled, torch.Tensor]) -> None:
    brief = replace(UHM["smoke"], shadow_steps=10, refine_steps=0)
    rough, smooth = (
        adapted(toy[0], replace(brief, weights=replace(brief.weights, variation=v)), 0, silent).shadows
        for v in (0.0, 1e5)
    )
    assert float(rough.min()) >= 0.0 and float(rough.max()) <= 1.0
    assert float(smooth.std()) < 0.7 * float(rough.std())


# --- parts ------------------------------------------------------------------------------------------------------------


def test_shadows_of_new_poses_go_by_the_normal_and_keep_what_is_the_texels_own() -> None:
    normals = torch.nn.functional.normalize(
        torch.randn(1, 20_000, 3, generator=torch.Generator().manual_seed(0)), dim=2
    )
    of_light = 0.5 + 0.3 * normals[..., 2]
    own = torch.where(torch.arange(20_000) % 4 == 0, -0.15, 0.05)  # every fourth texel is darker, whatever its normal
    seen = normals[..., 2] > -0.2
    shadowing = Shadowing(of_light + own, normals, seen)
    shown = torch.nonzero(seen[0])[:, 0]
    assert torch.allclose(shadowing.at(normals[0, shown], shown), (of_light + own)[0, shown], atol=1e-5)
    turned = normals[0, shown].flip(0)  # each texel faces as another one did
    truth = 0.5 + 0.3 * turned[:, 2] + own[shown]
    off, stuck = (part - truth for part in (shadowing.at(turned, shown), (of_light + own)[0, shown]))
    assert float(off.abs().mean()) < 0.06 < 0.1 < float(stuck.abs().mean())  # the kernel blurs 19 degrees
    shadows, usual = (of_light + own)[0, shown], 0.01 * len(shown)

    def plainly(normal: torch.Tensor) -> torch.Tensor:
        """The kernel at all texels, no table."""
        alike = torch.exp(12.0 * (normal @ normals[0, shown].T - 1.0))
        return (alike @ shadows + usual * shadows.mean()) / (alike.sum(dim=1) + usual)

    few = shown[:200]
    told = shadowing.at(turned[:200], few) - shadowing.at(normals[0, few], few)
    assert float((told - plainly(turned[:200]) + plainly(normals[0, few])).abs().max()) < 0.01
    away = torch.tensor([[0.0, 0.0, -1.0]])  # no picture showed such a normal: the mean, not what the others point to
    assert abs(float(shadowing.at(away, shown[1:2])) - float((of_light + own)[seen].mean())) < 0.1


def test_normal_maps_turn_normals_in_orthonormal_frames() -> None:
    rng = np.random.default_rng(0)
    normal, along, values = (torch.from_numpy(rng.normal(size=(50, 3))) for _ in range(3))
    normal = torch.nn.functional.normalize(normal, dim=1)
    for tangents in (along, None):
        axes = torch.stack([mapped(normal, tangents, torch.eye(3).double()[k].expand(50, 3)) for k in range(3)], dim=1)
        assert torch.allclose(axes @ axes.transpose(1, 2), torch.eye(3).double().expand(50, 3, 3), atol=1e-9)
        assert torch.allclose(axes[:, 2], normal)
        expected = torch.nn.functional.normalize((values[:, :, None] * axes).sum(dim=1), dim=1)
        assert torch.allclose(mapped(normal, tangents, values), expected)


def test_tangents_are_where_u_grows() -> None:
    hand = hand_model()
    surface = HandSurface(hand, 0)
    vertices = torch.tensor(hand.rest_position(0)).float()
    along = surface.tangents(vertices)
    uvs, uv_faces = surface.topology.unwrapped
    corners = vertices[surface.faces].double()
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    gram = torch.stack([torch.stack([(a * b).sum(1) for b in (first, second)], 1) for a in (first, second)], 1)
    right = torch.stack([(along.double() * edge).sum(1) for edge in (first, second)], 1)
    share = torch.linalg.solve(gram, right)[:, :, None]
    moved = (share.numpy() * (uvs[uv_faces[:, 1:]] - uvs[uv_faces[:, :1]])).sum(axis=1)
    assert np.median(np.abs(moved - [1.0, 0.0]).max(axis=1)) < 1e-3


def test_textures_without_structure_cost_nothing() -> None:
    used, generator = torch.ones(8, 8, dtype=torch.bool), torch.Generator().manual_seed(0)
    assert float(jitter(torch.full((3, 8, 8), 0.4), used, 2.0, generator)) == 0.0
    assert float(jitter(torch.rand(3, 8, 8, generator=generator), used, 2.0, generator)) > 0.1
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 8, 8)
    assert float(upright(up, used)) == 0.0 < float(upright(up * 0.5, used))


def test_the_light_of_known_normals_is_found() -> None:
    rng = np.random.default_rng(1)
    normal = rng.normal(size=(3000, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal[normal[:, 2] > 0.1]
    true = np.array([-0.6, 0.0, 0.8])
    share, found = lit_from(normal, 7.0 * (0.3 + 0.7 * np.maximum(normal @ true, 0.0)))
    assert abs(share - 0.3) < 0.01 and found @ true > 0.999
    assert np.isfinite(lit_from(normal, np.zeros(len(normal)))[1]).all()


def test_soft_shadows_agree_with_rays_away_from_edges() -> None:
    hand = hand_model()
    canvas = Canvas(hand.mesh(hand.neutral(), hand.named_pose("rest"), 1), camera(), 96)
    position = np.array([0.3, -0.5, 0.15])
    points = canvas.position.T.double().numpy()
    towards = position - points
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    facing = (canvas.normal.T.numpy() * towards).sum(axis=1) > 0.3
    soft = visibility(canvas.surface.mesh, position, points, 256)
    rays = canvas.surface.mesh.rays
    hard = ~rays.occluded(points + 1e-4 * canvas.normal.T.numpy(), towards)
    sure = facing & ((soft > 0.95) | (soft < 0.05))
    assert sure.sum() > 0.7 * facing.sum() and (~hard)[facing].mean() > 0.02
    assert (hard == (soft > 0.5))[sure].mean() > 0.95


def test_configurations_of_authors_are_theirs() -> None:
    released = HARP["released"]
    assert (released.steps, released.batch, released.rate, released.appearance_rate) == ((1000,) * 3, 18, 1e-3, 1e-2)
    assert released.weights == type(released.weights)(7.0, 10.0, 2.0, 0.1, 4.0, 0.2, 1.0, 1.0, 0.5, 0.1)
    assert isinstance(released, HarpConfig) and released.space == "display" and released.tangents == "duff"
