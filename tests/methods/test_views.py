"""Light as it is recorded: single lights, groups, near lights and any mixture become the same exact sums."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import torch

from handbench.data.capture import Capture
from handbench.errors import Unsupported
from handbench.light.lightset import LightSet, light_samples
from handbench.method import Recording
from handbench.methods.kit.views import TrainingView, views
from handbench.methods.relightablehands.config import PRESETS as HANDS_PRESETS
from handbench.methods.relightablehands.model import RelightableHandsModel, ViewedTexels, lit
from handbench.methods.relightablehands.training import exposure
from handbench.methods.relightablehands.training import train as train_hands
from handbench.methods.urhand.config import PRESETS, UrhandConfig
from handbench.methods.urhand.method import URHand
from handbench.render.shade.shading import light_features
from handbench.scene import Directional, Frame, Group, Light, Observation, Point

SMOKE = PRESETS["smoke"]


@pytest.fixture(scope="module")
def everything(mini: Capture) -> Recording:
    """Single lights, groups and fully lit frames of a training pose; the last two lights are held out."""
    frames = [f for f in mini.frames() if f.subject == "s01" and f.pose_name == "pose-0" and f.kind != "environment"]
    return mini.recording(f for f in frames if f.lighting not in ("olat-06", "olat-07"))


@pytest.fixture(scope="module")
def grouped(everything: Recording) -> Recording:
    """Groups and fully lit frames from one side."""
    return everything.of_kind("group", "full").where(lambda frame: frame.camera.name == "dorsal")


def nearby(frame: Frame, distance: float = 0.6) -> Point:
    """The near light in a frame's first direction that is as bright in the hand's middle."""
    (leaf, *_) = frame.light.lights if isinstance(frame.light, Group) else (frame.light,)
    assert isinstance(leaf, Directional)
    middle = frame.mesh.vertices.mean(axis=0)
    return Point(middle + distance * leaf.direction, leaf.irradiance * distance**2)


def relit(recording: Recording, light: Callable[[Frame], Light]) -> Recording:
    """The recording with other lights told for its single-light and group frames, the pictures as they are."""
    known = {frame.key: frame for frame in recording.frames}
    changed = [f if f.kind == "full" else replace(f, light=light(f)) for f in recording.frames]
    return Recording(changed, lambda frame: recording.observe(known[frame.key]))


def shaded(view: TrainingView, lights: LightSet, visible: torch.Tensor | None) -> torch.Tensor:
    rough = torch.full((view.posed.atlas.count,), 0.4)
    features = light_features(view.posed.normal, view.posed.position, rough, view.centre, lights, visible)
    return torch.cat(features)


@pytest.mark.parametrize("shadows", ["hard", "soft", "none"])
def test_a_group_view_is_the_sum_of_its_single_lights(
    everything: Recording, grouped: Recording, shadows: Literal["hard", "soft", "none"]
) -> None:
    single, group = views(everything.of_kind("olat"), 64, shadows)[0], views(grouped, 64, shadows)[0]
    assert single.power.shape == (6, 6, 3) and group.power.shape == (2, 6, 3)
    weights = np.array([0.4, 1.7])
    lights, visible, picture = group.lit_by(weights)
    # the same light from single pictures: what each direction has in the groups over what it has alone
    order = [int(np.flatnonzero((single.directions == d).all(axis=1))[0]) for d in group.directions]
    alone = np.zeros(6)
    alone[order] = (weights @ group.power[..., 0]) / np.diagonal(single.power[..., 0])[order]
    expected_lights, expected_visible, expected = single.lit_by(alone)
    assert len(lights) == len(expected_lights) == 6
    assert torch.allclose(picture, expected, rtol=5e-3, atol=1e-3)  # pictures are kept as half floats
    features = shaded(single, expected_lights, expected_visible)
    assert torch.allclose(shaded(group, lights, visible), features, rtol=1e-4, atol=1e-5 * float(features.max()))
    assert features.max() > 0.1


def test_single_lights_are_handed_over_as_recorded(everything: Recording) -> None:
    """Bit for bit: what a training computed before groups were accepted is computed now."""
    view = views(everything, 64)[0]
    first = everything.frames[0]
    frames = [f for f in everything.of_kind("olat").frames if f.pose_key == first.pose_key and f.camera is first.camera]
    weights = np.array([0.0, 0.3, 0.0, 1.1, 0.7, 0.0])
    lights, visible, picture = view.lit_by(weights)
    used = [frames[i] for i in np.flatnonzero(weights)]
    recorded = [light_samples(frame.light) for frame in used]
    assert np.array_equal(lights.directions, np.concatenate([one.directions for one in recorded]))
    irradiance = np.concatenate([one.irradiance for one in recorded]) * weights[weights > 0][:, None]
    assert np.array_equal(lights.irradiance, irradiance)
    assert visible is not None and torch.equal(visible, view.posed.visibility(lights))
    images = [torch.tensor(everything.observe(f).image[view.box].transpose(2, 0, 1)) for f in used]
    scale = torch.from_numpy(weights[weights > 0]).float()
    assert torch.equal(picture, torch.einsum("lchw,l->chw", torch.stack(images).half().float(), scale))


def test_a_group_adds_nothing_to_its_single_lights_but_new_ones(everything: Recording) -> None:
    assert len(views(everything, 64)[0].images) == 6
    without = everything.where(lambda frame: frame.lighting != "olat-00")
    mixed = views(without, 64)[0]
    assert len(mixed.images) == 6 and len(mixed.directions) == 6  # the group with the missing light has come in
    together = mixed.power[mixed.power.any(axis=2).sum(axis=1) > 1]
    assert len(together) == 1


def test_near_lights_fall_off_and_have_visibility(everything: Recording) -> None:
    told = relit(everything.of_kind("olat"), lambda f: nearby(f) if f.lighting in ("olat-01", "olat-03") else f.light)
    view = views(told, 64)[0]
    assert view.directions.shape == (4, 3) and view.positions.shape == (2, 3)
    weights = np.array([0.5, 2.0, 0.0, 1.0, 0.0, 0.0])
    lights, visible, _ = view.lit_by(weights)
    frames = told.frames[:4]
    assert np.array_equal(lights.directions, [frames[0].light.direction])  # type: ignore[union-attr]
    assert np.array_equal(lights.positions, [frames[i].light.position for i in (1, 3)])  # type: ignore[union-attr]
    assert np.allclose(lights.intensities, [w * frames[i].light.intensity for i, w in ((1, 2.0), (3, 1.0))])  # type: ignore[union-attr]
    assert visible is not None and torch.equal(visible, view.posed.visibility(lights))
    # a near light far away is the distant one
    far = relit(everything.of_kind("olat"), lambda f: nearby(f, 1e4))
    distant = views(everything.of_kind("olat"), 64)[0]
    one, other = (v.lit_by(np.array([0, 0, 1.0, 0, 0, 0])) for v in (views(far, 64)[0], distant))
    features = shaded(distant, *other[:2])
    assert (shaded(distant, *one[:2]) - features).abs().mean() < 1e-3 * features.mean()


def test_colours_of_one_direction_stay_apart(everything: Recording) -> None:
    """Two pictures under the same direction in different colours share its shadow and keep their own power."""

    def told(frame: Frame) -> Light:
        colour = {"olat-00": [3.0, 0.0, 0.0], "olat-01": [0.0, 3.0, 1.0]}.get(frame.lighting, [3.0, 3.0, 3.0])
        direction = [0.0, 0.6, 0.8] if frame.lighting in ("olat-00", "olat-01") else [0.6, 0.0, 0.8]
        return Directional(np.array(direction), np.array(colour))

    view = views(relit(everything.of_kind("olat"), told), 64)[0]
    assert view.directions.shape == (2, 3)
    lights, visible, _ = view.lit_by(np.array([1.0, 2.0, 0, 0, 0, 0]))
    assert np.array_equal(lights.irradiance, [[3.0, 6.0, 2.0]])
    assert visible is not None and len(visible) == 1


def test_dark_pictures_are_left_out(everything: Recording) -> None:
    single = everything.of_kind("olat")
    dark = relit(single, lambda f: f.light.scaled(0.0) if f.lighting == "olat-02" else f.light)
    assert len(views(dark, 64)[0].images) == 5
    with pytest.raises(Unsupported, match="urhand trains on single-light or group frames"):
        views(relit(single, lambda f: Group(())), 64)


@pytest.mark.parametrize(
    "config",
    [
        SMOKE,
        replace(SMOKE, encoder="environment"),
        replace(SMOKE, shadows="none"),
        replace(SMOKE, shadows="soft"),
        replace(SMOKE, shading="released", exposure=True),
        replace(SMOKE, network="non-linear", consistency=1.0, consistency_every=1),
    ],
    ids=lambda config: f"{config.encoder}-{config.shading}-{config.shadows}-{config.network}",
)
def test_urhand_trains_on_groups_alone(grouped: Recording, config: UrhandConfig) -> None:
    avatar = URHand(replace(config, steps=4, warmup=2)).train(grouped, 0).personalise(grouped)
    frame = grouped.of_kind("full").frames[0]
    drawn, truth = avatar.relight(frame).image, grouped.observe(frame).image
    assert np.isfinite(drawn).all()
    assert 0.2 * truth.mean() < drawn.mean() < 5.0 * truth.mean()


def test_urhand_learns_from_groups(grouped: Recording) -> None:
    frames = grouped.of_kind("group").frames[::2]

    def error(steps: int) -> float:
        avatar = URHand(replace(SMOKE, steps=steps)).train(grouped, 0).personalise(grouped)
        return float(np.mean([np.abs(avatar.relight(f).image - grouped.observe(f).image).mean() for f in frames]))

    assert error(25) < 0.8 * error(1)


def test_urhand_trains_on_groups_of_near_lights(grouped: Recording) -> None:
    near = relit(grouped, lambda f: Group((nearby(f), nearby(f, 0.9).scaled(0.5))))
    avatar = URHand(replace(SMOKE, steps=4)).train(near, 0).personalise(near)
    frame = near.of_kind("group").frames[0]
    drawn = avatar.relight(frame).image
    assert np.isfinite(drawn).all() and drawn.max() > 0.05


@pytest.mark.parametrize("change", [{"encoder": "environment"}, {"shading": "released"}, {"exposure": True}])
def test_who_knows_distant_lights_only_says_so_before_training(grouped: Recording, change: dict[str, object]) -> None:
    near = relit(grouped, lambda f: Group((nearby(f), f.light)))
    with pytest.raises(Unsupported, match="trains on distant lights only, and frames of s01 have near ones"):
        URHand(replace(SMOKE, **change)).train(near, 0)  # type: ignore[arg-type]


def test_relightablehands_trains_on_groups_and_near_lights(grouped: Recording, everything: Recording) -> None:
    config = replace(HANDS_PRESETS["smoke"], steps=3)
    mixed = relit(grouped, lambda f: Group((nearby(f), f.light)))
    for recording in (grouped, mixed):
        told: list[dict[str, float]] = []
        model = train_hands(config, recording, 0, lambda step, total, told=told, **values: told.append(values))
        assert np.isfinite(told[-1]["loss"])
        assert 0.5 < float(model.exposure) / exposure(views(everything.of_kind("olat"), 64)) < 2.0


def test_relightablehands_sees_a_far_light_as_a_distant_one(everything: Recording) -> None:
    view = views(everything.of_kind("olat"), 64)[0]
    torch.manual_seed(0)
    model = RelightableHandsModel(HANDS_PRESETS["smoke"], len(view.joints), 0.3)
    surface, visible = ViewedTexels.of(view.posed, view.centre, view.joints), view.visible
    assert visible is not None
    direction, middle = view.directions[:1], view.posed.position.mean(dim=1).numpy()
    with torch.no_grad():
        distant = lit(model.responses(surface, direction, visible[:1])[0], np.full((1, 3), 2.0))
        answers = [
            lit(
                model.responses(surface, np.zeros((0, 3)), visible[:1], middle + away * direction)[0],
                np.full((1, 3), 2.0 * away**2),
            )
            for away in (1e3, 0.3)
        ]
    assert (answers[0] - distant).abs().max() < 1e-2 * distant.max()
    assert (answers[1] - distant).abs().max() > 0.1 * distant.max()


def test_relightablehands_refuses_black_groups(grouped: Recording) -> None:
    def black(frame: Frame) -> Observation:
        seen = grouped.observe(frame)
        return replace(seen, image=seen.image * 0)

    with pytest.raises(Unsupported, match="all are black"):
        train_hands(HANDS_PRESETS["smoke"], Recording(grouped.frames, black))
