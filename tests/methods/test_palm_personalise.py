"""PALM-Net's personalisation on a ball: albedo, place and light of one picture."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from torch import Tensor

from handbench.errors import NonFinite, Unsupported
from handbench.hand.openhand import OpenHand
from handbench.light.gaussians import SphericalGaussians
from handbench.method import silent
from handbench.methods.kit.enrolled import Enrolled, PosedPicture
from handbench.methods.palm import personalise
from handbench.methods.palm.drawing import pixel_rays
from handbench.methods.palm.light import StudioLight
from handbench.methods.palm.personalise import Basis, personalised
from handbench.methods.palm.scattering import Scattering
from handbench.methods.palm.settings import FitRates, FitWeights, PersonaliseSettings
from handbench.methods.palm.shading import shared
from handbench.methods.palm.startlight import solved
from handbench.scene import Camera, Observation

from .palmball import Ball, March, render

HAND = OpenHand.load()
CAMERA = Camera(
    "front", 40, 40, np.array([[110.0, 0, 20], [0, 110.0, 20], [0, 0, 1]]), np.c_[np.diag([1.0, -1, -1]), [0, 0, 0.4]]
)
PSI = torch.tensor([[0.2, -0.3, -0.8], [0.9, 0.4, 0.1], [-0.6, -1.0, -1.4], [0.4, 0.1, -0.3]])
TRUE = PSI.mean(dim=0) + 0.5 * (PSI[1] - PSI[2]) / 2.0
QUICK = PersonaliseSettings(
    steps=40,
    rays=120,
    patch=12,
    side=40,
    samples=128,
    places=1,
    components=2,
    whitened=True,
    lit_from=0.0,
    solved=True,
    rebuild=20,
    falling=0.9,
    weights=FitWeights(radiance=0.0, physical=1.0, mask=0.5),
    rates=FitRates(0.05, 1e-4, 1e-3, 0.02),
)


class Codes(NamedTuple):
    geometry: Tensor
    appearance: Tensor


class Model(SimpleNamespace):
    """Balls of four albedos, learned in a grey studio."""

    def __init__(self) -> None:
        super().__init__(hand=HAND, phi=torch.zeros(4, 2), psi=PSI, light=StudioLight(8))
        self.config = SimpleNamespace(marching=None)


def posed(model: Model, codes: Codes, shape: Tensor, joints: Tensor, rotation: Tensor, translation: Tensor) -> Ball:
    return Ball(translation, torch.sigmoid(codes.appearance))


@pytest.fixture(autouse=True)
def analytic(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("render", render), ("PosedHand", posed), ("LatentCodes", Codes)):
        monkeypatch.setattr(personalise, name, value)


def lamp() -> SphericalGaussians:
    """Warm light from the upper right, cool from below: none that the studio has."""
    axes = torch.nn.functional.normalize(torch.tensor([[1.0, 1.0, 1.0], [-0.3, -1.0, 0.5]]), dim=1)
    return SphericalGaussians(axes, torch.tensor([6.0, 2.0]), torch.tensor([[2.0, 1.6, 1.2], [0.2, 0.3, 0.4]]))


def picture(ball: Ball, light: SphericalGaussians) -> tuple[Tensor, Tensor]:
    """Colours (R, 3) and alpha (R,) of the camera's pixels."""
    towards = pixel_rays(CAMERA, CAMERA.whole)[1]
    march = render(ball, torch.from_numpy(CAMERA.centre).float().expand(len(towards), 3), towards, None, None)
    places = Scattering.of(march, march).drawn(4)  # type: ignore[arg-type]
    return shared(places, light, None, 512, np.random.default_rng(0)), march.alpha


def enrolled() -> Enrolled:
    """The picture of the ball at the wrist, whose place is told 3 mm off."""
    image, alpha = picture(Ball(torch.zeros(3), torch.sigmoid(TRUE)), lamp())
    observation = Observation(image.reshape(40, 40, 3).numpy(), alpha.reshape(40, 40).clamp(0, 1).numpy())
    pose = replace(HAND.named_pose("rest"), translation=np.array([0.003, 0.0, 0.0]))
    return Enrolled(HAND, np.asarray(HAND.neutral()), (PosedPicture("s1/rest", CAMERA, observation, pose),))


def test_albedo_place_and_light_are_found_together() -> None:
    person = personalised(Model(), enrolled(), QUICK, "released", 0, silent)
    there, alpha = picture(Ball(torch.zeros(3), torch.sigmoid(TRUE)), lamp())
    again, _ = picture(Ball(torch.zeros(3), torch.sigmoid(person.codes.appearance)), person.light)
    inner = alpha > 0.99
    error = float((again - there)[inner].square().mean().sqrt())
    assert error < 0.04 * float(there[inner].max())


def test_the_same_seed_finds_the_same_person() -> None:
    few = replace(QUICK, steps=4)
    first, second = (personalised(Model(), enrolled(), few, "released", 3, silent) for _ in range(2))
    assert torch.equal(first.codes.appearance, second.codes.appearance)
    assert torch.equal(first.light.amplitude, second.light.amplitude)


def test_a_fixed_light_is_the_studios_as_bright_as_the_picture() -> None:
    model = Model()
    few = replace(QUICK, steps=6, light="fixed")
    person = personalised(model, enrolled(), few, "released", 0, silent)
    before = model.light.gaussians()
    assert torch.equal(person.light.axes, before.axes) and torch.equal(person.light.sharpness, before.sharpness)
    ratio = person.light.amplitude / before.amplitude
    assert torch.allclose(ratio, ratio[:1, :1].expand_as(ratio)) and not torch.allclose(ratio, torch.ones(1))


def test_a_hand_smaller_than_a_patch_and_a_broken_step_are_told() -> None:
    with pytest.raises(Unsupported, match="less than a patch of 64; give a larger picture"):
        personalised(Model(), enrolled(), replace(QUICK, patch=64), "released", 0, silent)
    broken = replace(QUICK, weights=replace(QUICK.weights, mask=float("nan")))
    with pytest.raises(NonFinite, match="mask of step 1 of a fit is not finite"):
        personalised(Model(), enrolled(), broken, "released", 0, silent)


def test_a_hand_that_is_not_finite_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def nowhere(*seen: Any) -> March:
        march = render(*seen)
        return replace(march, weight=march.weight * torch.nan)

    monkeypatch.setattr(personalise, "render", nowhere)
    with pytest.raises(NonFinite, match="mask of step 1 of a fit is not finite"):
        personalised(Model(), enrolled(), QUICK, "released", 0, silent)


def test_a_gradient_that_is_not_finite_is_told_before_it_moves_anything(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the only step, too: a person would else be handed out whose codes and light are NaN."""
    shown = personalise.to_display

    def steep(values: Tensor, space: str) -> Tensor:
        return shown(values, space) + (values * 0.0).sqrt()  # 0, and its slope is infinite

    monkeypatch.setattr(personalise, "to_display", steep)
    with pytest.raises(NonFinite, match="gradient to codes in step 1 of a fit is not finite"):
        personalised(Model(), enrolled(), replace(QUICK, steps=1), "released", 0, silent)


def test_basis_is_the_principal_components_of_the_codes() -> None:
    codes = torch.from_numpy(np.random.default_rng(0).normal(size=(20, 6)) * [5, 3, 1, 0.1, 0.1, 0.1]).float()
    plain, white = Basis(codes, 3, whitened=False), Basis(codes, 3, whitened=True)
    assert torch.allclose(plain.axes @ plain.axes.T, torch.eye(3), atol=1e-5)
    assert torch.equal(plain.code(torch.zeros(3)), torch.zeros(6))
    assert torch.allclose(white.code(torch.zeros(3)), codes.mean(dim=0))
    along = (codes - codes.mean(dim=0)) @ plain.axes.T
    assert torch.allclose(white.axes.norm(dim=1), along.std(dim=0), rtol=1e-4)
    assert Basis(codes[:3], 5, whitened=True).count == 2


def test_light_is_solved_by_least_squares_and_unseen_lobes_stay() -> None:
    rng = np.random.default_rng(1)
    known = torch.from_numpy(rng.uniform(0.0, 1.0, (200, 3, 3))).float()
    known[:, 2] = 0.0  # lights nothing that is seen
    amplitude = torch.tensor([[1.0, 2.0, 3.0], [4.0, 1.0, 2.0], [0.0, 0.0, 0.0]])
    image = torch.einsum("rgc,gc->rc", known, amplitude)
    before = torch.ones(3, 3)
    found = solved(known, image, before)
    assert torch.allclose(found[:2], amplitude[:2], rtol=0.25)
    brightness = float(image.sum() / known.sum())
    assert torch.allclose(found[2], torch.full((3,), brightness), rtol=1e-3)
