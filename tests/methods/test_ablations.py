"""Every ablation of URHand trains, draws, and does what its name says."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from handbench.light.environment import solid_angles
from handbench.light.lightset import light_samples
from handbench.method import Recording
from handbench.methods.ablations import ABLATIONS
from handbench.methods.urhand import create
from handbench.methods.urhand.config import PRESETS, UrhandConfig
from handbench.methods.urhand.lighting import environment_map
from handbench.methods.urhand.method import URHand
from handbench.methods.urhand.model import URHandModel
from handbench.methods.urhand.training import Lesson
from handbench.registry import METHODS
from handbench.scene import Directional, Group

SMOKE = PRESETS["smoke"]


@pytest.fixture(scope="module")
def training(training: Recording) -> Recording:
    """One pose from one side: what is looked at here doesn't need more."""
    return training.where(lambda frame: frame.pose_name == "pose-0" and frame.camera.name == "palmar")


@pytest.fixture(scope="module")
def enrolment(enrolment: Recording) -> Recording:
    """One picture."""
    first = enrolment.frames[0]
    return enrolment.where(lambda frame: frame is first)


def test_overrides_name_fields_and_change_them() -> None:
    base = asdict(UrhandConfig())
    for name, ablation in ABLATIONS.items():
        assert ablation.overrides, name
        for field, value in ablation.overrides.items():
            assert base[field] != value, (name, field)


def test_every_ablation_is_a_method_with_its_own_title() -> None:
    made = {name: METHODS.load(f"urhand-{name}")(preset="smoke") for name in ABLATIONS}
    assert len({method.info.title for method in made.values()}) == len(ABLATIONS)
    assert {name for name, method in made.items() if not method.info.linear} == {"non-linear", "linear-consistency"}


def answers(method: URHand, training: Recording, enrolment: Recording) -> tuple[np.ndarray, float]:
    """A picture, and the largest deviation from additivity."""
    avatar = method.train(training, 0).personalise(enrolment)
    frame = enrolment.frames[0]
    one, two = (Directional(d, np.ones(3)) for d in (np.array([0.6, 0.8, 0.0]), np.array([0.0, 0.8, 0.6])))
    images = [
        avatar.relight(replace(frame.query, light=light, lighting=name)).image.astype(np.float64)
        for name, light in (("one", one), ("two", two), ("both", Group((one, two))))
    ]
    return images[2], float(np.abs(images[0] + images[1] - images[2]).max() / np.abs(images[2]).max())


@pytest.mark.parametrize("name", ABLATIONS)
def test_an_ablation_trains_and_keeps_or_breaks_linearity(name: str, training: Recording, enrolment: Recording) -> None:
    config = replace(SMOKE, steps=2, **ABLATIONS[name].overrides)
    method = create("smoke", name)
    image, deviation = answers(URHand(config, method.info), training, enrolment)
    assert np.isfinite(image).all() and image.max() > 0.0
    assert (deviation < 1e-5) == method.info.linear, deviation


def test_the_released_form_draws_and_is_not_additive(training: Recording, enrolment: Recording) -> None:
    config = replace(PRESETS["released"], texture=64, steps=2)
    image, deviation = answers(URHand(config), training, enrolment)
    assert np.isfinite(image).all() and image.max() > 0.0
    assert deviation > 1e-4
    assert not create("released").info.linear


def test_an_environment_map_keeps_power_and_direction(mini) -> None:
    frame = next(f for f in mini.frames() if f.lighting == "env-brightday")
    lights = light_samples(frame.light, (16, 32))
    radiance = environment_map(lights, (16, 32)).double().numpy()
    power = (radiance * solid_angles(16, 32)).sum(axis=(1, 2))
    assert np.allclose(power, lights.irradiance.sum(axis=0), rtol=1e-6)
    assert np.count_nonzero(radiance.any(axis=0)) == len(lights.directions)  # each texel's light falls back into it


def test_losses_are_those_of_the_configuration(training: Recording) -> None:
    def terms(**changes: object) -> set[str]:
        config = replace(SMOKE, **changes)  # type: ignore[arg-type]
        torch.manual_seed(0)
        lesson = Lesson(URHandModel(config, len(training.frames[0].pose.joints)), training)
        return set(lesson.losses(0, np.random.default_rng(0)))

    assert terms() == {"l1", "perceptual", "sparsity", "adversarial"}
    assert terms(adversarial=0.0, sparsity=0.0) == {"l1", "perceptual", "sparsity"}
    assert terms(consistency=1.0, consistency_every=1) == {"l1", "perceptual", "sparsity", "adversarial", "consistency"}
    assert terms(neural=False, adversarial=0.0) == {"l1", "perceptual"}


def test_the_linear_network_has_no_inconsistency_and_the_non_linear_one_has(training: Recording) -> None:
    def inconsistency(network: str) -> float:
        config = replace(SMOKE, network=network, consistency=1.0, consistency_every=1)  # type: ignore[arg-type]
        torch.manual_seed(0)
        model = URHandModel(config, len(training.frames[0].pose.joints))
        torch.nn.init.normal_(model.neural.decoder.convolutions[-1].weight)  # it starts as physics, which is linear
        return float(Lesson(model, training).losses(0, np.random.default_rng(0))["consistency"].detach())

    assert inconsistency("linear") < 1e-5
    assert inconsistency("non-linear") > 1e-3


def test_bfloat16_stays_near_float32(training: Recording, enrolment: Recording) -> None:
    images = []
    for bfloat16 in (False, True):
        avatar = URHand(replace(SMOKE, steps=1, bfloat16=bfloat16)).train(training, 0).personalise(enrolment)
        images.append(avatar.relight(enrolment.frames[0].query).image)
    difference = np.abs(images[0] - images[1]).max() / images[0].max()
    assert 0.0 < difference < 0.05
