"""RelightableHands: Eq. 7 as printed and as released, a sum over lights, trainable one subject at a time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from othercamera import check_seen_by

from handbench.checkpoint import checkpoints_in
from handbench.errors import InputError, Unsupported
from handbench.method import Avatar, Recording
from handbench.methods.kit.views import TrainingView, views
from handbench.methods.relightablehands.config import PRESETS, RelightableHandsConfig
from handbench.methods.relightablehands.frames import tangent_frames
from handbench.methods.relightablehands.method import RelightableHands, RelightableHandsAvatar
from handbench.methods.relightablehands.model import RelightableHandsModel, ViewedTexels, coloured
from handbench.methods.relightablehands.training import exposure, train
from handbench.registry import METHODS
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Directional, Environment, Group, Light, Mesh, Point, Query
from handbench.skips import Skips, skipping

SMOKE = PRESETS["smoke"]


@pytest.fixture(scope="module")
def avatar(training: Recording) -> Avatar:
    return RelightableHands(replace(SMOKE, steps=12)).train(training).personalise(training, seed=0)


def test_another_camera_shares_the_pose(avatar: Avatar, training: Recording) -> None:
    check_seen_by(avatar, training.frames[0].query)


@pytest.fixture(scope="module")
def seen(training: Recording) -> list[TrainingView]:
    return views(training, SMOKE.texture)


def asked(training: Recording, light: Light) -> Query:
    return replace(training.frames[0].query, light=light, lighting="test")


def picture(avatar: Avatar, query: Query) -> np.ndarray:
    return avatar.relight(query).image.astype(np.float64)


def sun(x: float, y: float, z: float, irradiance: tuple[float, float, float] = (2.0, 2.0, 2.0)) -> Directional:
    direction = np.array([x, y, z])
    return Directional(direction / np.linalg.norm(direction), np.array(irradiance))


def test_equation_7_in_both_forms() -> None:
    # sigma(0) = 1/2; by hand: outside (relu(25 t) + 100) / 2, inside relu(25 t + 100) / 2
    texture = torch.tensor([[2.0, -1.0, -6.0]]).expand(3, -1)
    shadow = torch.zeros(1, 3)
    outside, cut = coloured(texture, shadow, "outside")
    assert torch.allclose(outside[0], torch.tensor([75.0, 50.0, 50.0]))
    assert torch.allclose(cut[0], torch.tensor([50.0, -25.0, -150.0]))
    inside, cut = coloured(texture, shadow, "inside")
    assert torch.allclose(inside[0], torch.tensor([75.0, 37.5, 0.0]))
    assert torch.allclose(cut[0], torch.tensor([150.0, 75.0, -50.0]))
    dark, _ = coloured(texture, torch.full((1, 3), -20.0), "outside")
    assert dark.abs().max() < 1e-6  # the shadow can darken all of it, the bias too


def test_texel_frames_follow_the_surface_and_the_texture(training: Recording) -> None:
    posed = PosedSurface(training.frames[0].mesh, 128)
    frames = tangent_frames(posed)
    gram = torch.einsum("ijn,kjn->nik", frames, frames)
    good = frames[0].norm(dim=0) > 0.5
    assert good.float().mean() > 0.99
    assert torch.allclose(gram[good], torch.eye(3).expand(int(good.sum()), 3, 3), atol=1e-5)
    # a step of one texel to the right is a step along the tangent: an oracle that knows no triangle
    position = posed.atlas.scatter(posed.position)
    chart = np.full(posed.atlas.size**2, -1)
    chart[posed.atlas.texels] = posed.atlas.chart
    chart = torch.from_numpy(chart.reshape(posed.atlas.size, -1))
    inside = (chart[:, 1:-1] >= 0) & (chart[:, :-2] == chart[:, 1:-1]) & (chart[:, 2:] == chart[:, 1:-1])
    step = (position[:, :, 2:] - position[:, :, :-2])[:, inside]
    tangent, bitangent = (posed.atlas.scatter(frames[i])[:, :, 1:-1][:, inside] for i in range(2))
    cosine = (step * tangent).sum(0) / step.norm(dim=0)
    assert cosine.median() > 0.98
    assert ((step * bitangent).sum(0) / step.norm(dim=0)).abs().median() < 0.1


def test_a_turned_hand_under_turned_light_and_camera_answers_alike(training: Recording) -> None:
    """The network cannot know how the wrist is turned, so nothing it sees may depend on it."""
    frame = training.frames[0]
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    torch.manual_seed(0)
    model = RelightableHandsModel(SMOKE, len(frame.pose.joints), 0.3)
    direction = sun(0.3, 0.8, 0.4).direction
    answers = []
    for vertices, centre, towards in (
        (frame.mesh.vertices, frame.camera.centre, direction),
        (frame.mesh.vertices @ turn.T, turn @ frame.camera.centre, turn @ direction),
    ):
        posed = PosedSurface(Mesh(vertices, frame.mesh.topology), SMOKE.texture)
        visible = torch.ones(1, posed.atlas.count)
        answers.append(
            model.responses(
                ViewedTexels.of(posed, centre, torch.from_numpy(frame.pose.joints.copy()).float()),
                towards[None],
                visible,
            )[0]
            .detach()
            .numpy()
        )
    assert np.abs(answers[0] - answers[1]).max() < 1e-4 * answers[0].max()


def test_light_adds(avatar: Avatar, training: Recording) -> None:
    rng = np.random.default_rng(0)
    lights: list[Light] = [
        Group((sun(0.2, 0.9, 0.3), sun(-0.7, 0.1, 0.6, (0.3, 1.0, 4.0)))),
        sun(0.5, -0.4, 0.7, (5.0, 0.2, 1.0)),
        Environment("noise", rng.gamma(0.3, size=(32, 64, 3))),
        Environment("other", rng.gamma(0.3, size=(16, 32, 3))),
    ]
    for one, other in zip(lights, [*lights[1:], lights[0]], strict=True):
        both = picture(avatar, asked(training, Group((one.scaled(0.7), other.scaled(1.9)))))
        apart = 0.7 * picture(avatar, asked(training, one)) + 1.9 * picture(avatar, asked(training, other))
        assert np.abs(both - apart).max() < 1e-4 * apart.max()
        assert apart.max() > 0.05  # the law is not kept by an empty answer


def test_no_light_no_picture(avatar: Avatar, training: Recording) -> None:
    for light in (Group(()), sun(0.0, 1.0, 0.0, (0.0, 0.0, 0.0)), Environment("night", np.zeros((16, 32, 3)))):
        assert not picture(avatar, asked(training, light)).any()


def test_every_colour_of_light_lights_its_own_channel(avatar: Avatar, training: Recording) -> None:
    white, red = (picture(avatar, asked(training, sun(0.2, 0.9, 0.3, c))) for c in ((2.0, 2.0, 2.0), (2.0, 0.0, 0.0)))
    assert np.allclose(red[..., 0], white[..., 0], atol=1e-6) and not red[..., 1:].any()


def test_what_is_kept_changes_nothing_and_is_bounded(
    avatar: Avatar, training: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert isinstance(avatar, RelightableHandsAvatar)
    light = Group((sun(0.2, 0.9, 0.3), sun(0.1, 0.2, 0.9), sun(0.2, 0.9, 0.3)))
    with skipping(Skips(known=False)):
        fresh = picture(avatar, asked(training, light))
    posed = avatar.pose(asked(training, light).viewpoint)
    posed.relight(sun(0.1, 0.2, 0.9))
    calls: list[int] = []
    monkeypatch.setattr(avatar._model.decoder, "forward", _counting(avatar._model.decoder.forward, calls))
    kept = posed.relight(light).image
    assert calls == [1]  # of three lights, one is known and two are the same
    assert np.abs(kept - fresh).max() < 1e-5 * fresh.max()
    posed.relight(light.scaled(3.0))
    assert calls == [1]
    monkeypatch.setattr("handbench.methods.relightablehands.method._KEPT_BYTES", 1)
    posed.relight(light)
    assert len(posed._kept) == 0


def _counting(forward, calls):  # type: ignore[no-untyped-def]
    def counted(inputs, pose):  # type: ignore[no-untyped-def]
        calls.append(len(inputs))
        return forward(inputs, pose)

    return counted


def test_training_lowers_its_loss_below_the_mean_picture(training: Recording, seen: list[TrainingView]) -> None:
    told: list[dict[str, float]] = []
    model = train(replace(SMOKE, steps=40), training, 0, lambda step, total, **values: told.append(values))
    assert told[-1]["l2"] < 0.8 * told[0]["l2"]
    error, floor = [], []
    for view in seen:
        surface = ViewedTexels.of(view.posed, view.centre, view.joints)
        with torch.no_grad():
            answers, _ = model.responses(surface, view.directions, view.visible)
        truth = view.images.float()
        drawn = torch.stack([3.0 * view.draw(answer) for answer in answers])  # the stage's lights have irradiance 3
        error.append(float((drawn - truth).square().mean()))
        floor.append(float((truth.mean(dim=0) - truth).square().mean()))
    # the best picture that does not look at the light, of each view: no method without light can be better
    assert np.mean(error) < 0.8 * np.mean(floor)


def test_exposure_follows_the_units_of_the_capture(training: Recording, seen: list[TrainingView]) -> None:
    found = exposure(seen)
    assert 0.1 < found < 1.0  # near 1 / pi, where 255 would be a white diffuse surface
    dimmer = [replace(view, images=view.images * 0.25) for view in seen]
    assert exposure(dimmer) == pytest.approx(0.25 * found, rel=1e-3)
    with pytest.raises(Unsupported, match="all are black"):
        exposure([replace(view, images=view.images * 0) for view in seen])


def test_training_repeats_by_seed(training: Recording) -> None:
    config = replace(SMOKE, steps=3)
    states = [train(config, training, seed).state_dict() for seed in (0, 0, 1)]
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])
    first = "decoder.encoder.0.layer.weight"
    assert (states[0][first] - states[2][first]).abs().mean() > 0.02  # another start, not only other lights


def test_a_killed_training_ends_as_an_uninterrupted_one(
    training: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(SMOKE, steps=4)
    expected = train(config, training, 0).state_dict()
    monkeypatch.setattr("handbench.methods.kit.checkpoint.EVERY", 0.0)

    def killed(step: int, total: int, **values: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("handbench.methods.kit.engine._TELL", 3)
    with checkpoints_in(tmp_path):
        with pytest.raises(KeyboardInterrupt):
            train(config, training, 0, killed)
        assert [path.name for path in tmp_path.iterdir()] == ["relightablehands-s01.safetensors"]
        resumed = train(config, training, 0).state_dict()
    assert all(torch.equal(expected[name], resumed[name]) for name in expected)


def test_the_prior_survives_the_disk(training: Recording, tmp_path: Path) -> None:
    method = RelightableHands(replace(SMOKE, steps=2))
    prior = method.train(training)
    prior.save(tmp_path)
    before, after = (p.personalise(training, 3) for p in (prior, method.load(tmp_path)))
    query = training.frames[0].query
    assert np.array_equal(picture(before, query), picture(after, query))
    with pytest.raises(InputError, match="were trained with"):
        RelightableHands(replace(SMOKE, steps=3)).load(tmp_path)


def test_what_it_cannot_do_has_a_reason(avatar: Avatar, training: Recording, enrolment: Recording) -> None:
    prior = RelightableHands(SMOKE).train(training)
    with pytest.raises(Unsupported, match="relightablehands trains on single-light or group frames"):
        prior.personalise(enrolment)
    many = Group(tuple(sun(np.cos(a), np.sin(a), 0.1) for a in np.linspace(0.0, 6.0, 1025)))
    with pytest.raises(Unsupported, match="1025 lights are more than 1024"):
        avatar.relight(asked(training, many))


def test_near_lights_add_to_distant_ones_and_are_kept(
    avatar: Avatar, training: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert isinstance(avatar, RelightableHandsAvatar)
    near = [Point(np.array([0.1 * k, 0.4, 0.5]), np.array([0.3, 0.2, 0.1])) for k in range(5)]
    distant = [sun(0.2, 0.9, 0.1 * k) for k in range(5)]
    query = asked(training, Group((*near, *distant, near[0])))  # more than go through the network at once
    posed = avatar.pose(query.viewpoint)
    both = posed.relight(query.light).image.astype(np.float64)
    apart = [picture(avatar, asked(training, light)) for light in (Group((*near, near[0])), Group(tuple(distant)))]
    assert np.abs(both - sum(apart)).max() < 1e-4 * both.max()
    assert min(part.max() for part in apart) > 0.02
    calls: list[int] = []
    monkeypatch.setattr(avatar._model.decoder, "forward", _counting(avatar._model.decoder.forward, calls))
    again = posed.relight(query.light).image
    assert not calls and np.abs(again - both).max() < 1e-5 * both.max()
    far = Point(1e3 * distant[0].direction, 1e6 * distant[0].irradiance)
    one, other = (picture(avatar, asked(training, light)) for light in (far, distant[0]))
    assert np.abs(one - other).max() < 2e-2 * other.max()


def test_settings_that_cannot_work() -> None:
    with pytest.raises(InputError, match="texture 100 is no multiple of 32"):
        RelightableHandsConfig(texture=100)
    with pytest.raises(InputError, match="environment_lights is 0"):
        RelightableHandsConfig(environment_lights=0)
    with pytest.raises(InputError, match="did you mean 'quick'"):
        METHODS.load("relightablehands")(preset="quik")


def test_it_is_registered_as_what_it_is() -> None:
    info = METHODS.load("relightablehands")(preset="smoke").info
    assert info.linear and not info.universal and "point" in info.lights
