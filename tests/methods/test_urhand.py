"""URHand: the seed's structure, linear in light, trainable, repeatable, and safe on disk."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from handbench.errors import InputError, NonFinite, Unsupported
from handbench.method import Recording
from handbench.methods.kit.views import views
from handbench.methods.reflectance import physical
from handbench.methods.urhand import lighting
from handbench.methods.urhand.config import PRESETS, UrhandConfig
from handbench.methods.urhand.method import URHand
from handbench.methods.urhand.model import URHandModel
from handbench.methods.urhand.networks import (
    BRANCH_CHANNELS,
    UNET_CHANNELS,
    EnvironmentEncoder,
    FeatureEncoder,
    NeuralBranch,
    PhysicalBranch,
)
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Frame, Group, Observation

SMOKE = PRESETS["smoke"]


@pytest.fixture(scope="module")
def training(training: Recording) -> Recording:
    """One pose: what is looked at here doesn't need more."""
    return training.where(lambda frame: frame.pose_name == "pose-0")


def parameter_count(module: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def test_channel_sizes_are_the_seeds() -> None:
    assert UNET_CHANNELS == (3, 64, 64, 64, 64, 64, 64)
    assert BRANCH_CHANNELS == (128, 256, 128, 128, 64, 32, 16, 4)
    branch = NeuralBranch(FeatureEncoder(), False, 0.25)
    outputs = [layer.conv.weight.shape[0] for layer in branch.decoder.layers[:6]]
    assert outputs == [256, 128, 128, 64, 32, 16]
    assert branch.decoder.layers[6].weight.shape[:2] == (4, 16)
    # 3.1 M parameters for the neural branch alone: the size that the published channel lists imply
    assert 3.0e6 < parameter_count(branch) < 3.3e6
    assert 0.6e6 < parameter_count(PhysicalBranch(60)) < 0.8e6


def test_nothing_in_the_linear_path_has_a_bias() -> None:
    branch = NeuralBranch(FeatureEncoder(), False, 0.25)
    for part in (branch.encoder, branch.decoder):
        assert not [name for name, _ in part.named_parameters() if "bias" in name]


def test_gain_and_bias_are_linear_in_the_features() -> None:
    torch.manual_seed(0)
    branch = NeuralBranch(FeatureEncoder(), False, 0.25).double()
    joint = torch.randn(1, 128, 1, 1, dtype=torch.float64)
    a, b = torch.randn(2, 1, 2, 64, 64, dtype=torch.float64)
    modulation = branch.nonlinear(joint)
    together, first, second = (torch.cat(branch(x, modulation)[:2], dim=1) for x in (0.3 * a + 1.7 * b, a, b))
    apart = 0.3 * first + 1.7 * second
    assert (together - apart).abs().max() < 1e-12 * apart.abs().max()
    assert apart.abs().max() > 0.01  # the law is not kept by an empty answer


@pytest.mark.parametrize("activated", [False, True])
def test_the_neural_branch_answers_alike_with_and_without_gradients(activated: bool) -> None:
    torch.manual_seed(0)
    for encoder in (FeatureEncoder(activated=activated), EnvironmentEncoder(1, (16, 32))):
        branch = NeuralBranch(encoder, activated, 0.25)
        for parameter in branch.parameters():
            parameter.data += 0.01 * torch.randn(parameter.shape)
        light = torch.rand(3, 2, 64, 64) if isinstance(encoder, FeatureEncoder) else torch.rand(1, 3, 16, 32)
        modulation = [factor.detach() for factor in branch.nonlinear(torch.rand(1, 128, 1, 1))]
        before = [light.clone(), *(factor.clone() for factor in modulation)]
        reference = torch.cat(branch(light, modulation)[:2], dim=1).detach()
        with torch.no_grad():
            gain, bias, encoded = branch(light, modulation)
        assert torch.allclose(torch.cat([gain, bias], dim=1), reference, rtol=1e-5, atol=1e-5 * float(reference.std()))
        assert not encoded and all(map(torch.equal, [light, *modulation], before))


def test_the_physical_branch_starts_at_the_coarse_surface(training: Recording) -> None:
    frame = training.frames[0]
    posed = PosedSurface(frame.mesh, 64)
    torch.manual_seed(0)
    model = URHandModel(SMOKE, len(frame.pose.joints))
    material = model.material(torch.rand(3, 64, 64), torch.zeros(len(frame.pose.joints), 3), posed)
    assert (material.normal * posed.normal).sum(0).mean() > 0.99
    assert torch.allclose(material.normal.norm(dim=0), torch.ones(posed.atlas.count), atol=1e-5)
    low, high = SMOKE.roughness
    assert (material.roughness - (low + high) / 2).abs().max() < 0.05


@pytest.mark.parametrize("seed", [0, 1])
def test_the_neural_branch_starts_as_the_physical_one(training: Recording, seed: int) -> None:
    torch.manual_seed(seed)
    model = URHandModel(SMOKE, len(training.frames[0].pose.joints))
    view = views(training, 64)[0]
    texture, atlas = torch.rand(3, 64, 64), view.posed.atlas
    material = model.material(texture, view.joints, view.posed)
    lights, visible, _ = view.lit_by(np.array([1.0, 0, 0, 2.0, 0, 0]))
    maps = (material.normal, material.roughness, view.posed.position, view.centre)
    features = lighting.features(SMOKE, *maps, lights, visible)
    final, _ = model.colour(features, lights, material, texture, atlas)
    physical_picture = model.physical_colour(features, texture, atlas)
    assert torch.allclose(final, physical_picture, atol=1e-6 * float(physical_picture.detach().max()))


def test_texture_must_halve_six_times() -> None:
    with pytest.raises(InputError, match="texture 100 is no multiple of 64"):
        UrhandConfig(texture=100)


def test_training_pictures_are_exact_sums(training: Recording) -> None:
    view = views(training, 64)[0]
    weights = np.zeros(6)
    weights[1], weights[4] = 0.5, 2.0
    _, visible, picture = view.lit_by(weights)
    frames = [f for f in training.of_kind("olat").frames if f.pose_key == training.frames[0].pose_key]
    one, four = (
        training.observe(f).image[view.box].transpose(2, 0, 1)
        for f in frames
        if f.camera is training.frames[0].camera and f.lighting in ("olat-01", "olat-04")
    )
    expected = 0.5 * one + 2.0 * four
    assert np.allclose(picture.numpy(), expected, rtol=2e-3, atol=1e-4)  # images are kept as half floats
    assert len(visible) == 2


def test_training_repeats_by_seed_with_several_threads(training: Recording) -> None:
    config = replace(SMOKE, steps=3)
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        first, *same, other = (URHand(config).train(training, seed).model.state_dict() for seed in (0, 0, 0, 1))
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(first[name], state[name]) for state in same for name in first)
    assert not all(torch.equal(first[name], other[name]) for name in first)


def test_training_starts_at_the_physics_and_improves_on_it(training: Recording) -> None:
    frames = training.of_kind("olat").frames

    def error(steps: int) -> float:
        avatar = URHand(replace(SMOKE, steps=steps)).train(training, 0).personalise(training)
        return float(np.mean([np.abs(avatar.relight(f).image - training.observe(f).image).mean() for f in frames]))

    start, later = error(1), error(25)
    physical_avatar = physical.create().train(training).personalise(training)
    fitted = np.mean([np.abs(physical_avatar.relight(f).image - training.observe(f).image).mean() for f in frames])
    assert start < 3.0 * fitted  # untrained, yet physics: a random network is off by more than ten times
    assert later < 0.85 * start


def test_relighting_is_linear_in_light(training: Recording, enrolment: Recording, mini) -> None:
    avatar = URHand(replace(SMOKE, steps=5)).train(training, 0).personalise(enrolment)
    frames = {f.lighting: f for f in mini.frames() if f.subject == "s02" and f.camera.name == "dorsal"}
    one, two = frames["olat-00"], frames["env-brightday"]
    both = replace(one, light=Group((one.light.scaled(0.7), two.light.scaled(1.3))))
    expected = 0.7 * avatar.relight(one).image + 1.3 * avatar.relight(two).image
    assert np.abs(avatar.relight(both).image - expected).max() < 1e-4 * np.abs(expected).max()


def test_saved_weights_answer_alike_and_refuse_another_configuration(
    training: Recording, enrolment: Recording, tmp_path: Path
) -> None:
    method = URHand(replace(SMOKE, steps=2))
    prior = method.train(training, 0)
    prior.save(tmp_path)
    frame = enrolment.frames[0]
    before, after = (p.personalise(enrolment).relight(frame).image for p in (prior, method.load(tmp_path)))
    assert np.array_equal(before, after)
    with pytest.raises(InputError, match="train again"):
        URHand(replace(SMOKE, steps=3)).load(tmp_path)
    weights = tmp_path / "weights.safetensors"
    weights.write_bytes(weights.read_bytes()[:1000])
    with pytest.raises(InputError, match=r"weights\.safetensors cannot be read"):
        method.load(tmp_path)


def test_nothing_is_trained_through_a_step_that_is_not_finite(training: Recording) -> None:
    def broken(frame: Frame) -> Observation:
        seen = training.observe(frame)
        if frame.kind != "olat":
            return seen
        return Observation(np.full_like(seen.image, 3e38), seen.alpha)  # overflows half floats to infinity

    with pytest.raises(NonFinite, match="urhand: step 1 gave l1 inf"), np.errstate(over="ignore"):
        URHand(replace(SMOKE, steps=2)).train(Recording(training.frames, broken), 0)


def test_what_training_needs_is_said(training: Recording) -> None:
    with pytest.raises(Unsupported, match="single-light or group frames"):
        URHand(SMOKE).train(training.of_kind("full"), 0)
    with pytest.raises(Unsupported, match="fully lit"):
        URHand(SMOKE).train(training.of_kind("olat"), 0)
