"""The perceptual and the adversarial loss."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from handbench.methods.kit import alexnet
from handbench.methods.kit.adam import Adam
from handbench.methods.kit.discriminator import Discriminator, discriminator_loss, generator_loss
from handbench.methods.kit.perceptual import PATCH, patch, perceptual_loss
from handbench.metrics import networks


def test_perceptual_loss_is_zero_for_equal_pictures_and_grows_with_blur() -> None:
    truth = torch.rand(3, 64, 48, generator=torch.Generator().manual_seed(0))
    blurs = [torch.nn.functional.avg_pool2d(truth, k, 1, k // 2)[..., :64, :48] for k in (1, 3, 7)]
    losses = perceptual_loss(torch.stack(blurs), truth)
    assert losses[0] < 1e-6  # rounding: batches of another size
    assert losses[0] < losses[1] < losses[2]


def test_perceptual_loss_takes_small_pictures_and_has_gradients() -> None:
    small = torch.rand(1, 3, 9, 5, generator=torch.Generator().manual_seed(0)).requires_grad_()
    loss = perceptual_loss(small, torch.rand(3, 9, 5)).sum()
    loss.backward()
    assert small.grad is not None and small.grad.isfinite().all() and small.grad.any()


def test_methods_see_what_lpips_sees_by_weights_of_their_own() -> None:
    pictures = torch.rand(2, 3, 64, 48, generator=torch.Generator().manual_seed(0))
    for own, judge in zip(alexnet.features(pictures), networks.features("alex", pictures, 3), strict=True):
        assert torch.equal(own, judge)
    assert all("handbench.metrics" not in path.read_text() for path in Path(alexnet.__file__).parent.glob("*.py"))


def test_patches_are_inside_and_reach_every_pixel() -> None:
    rng = np.random.default_rng(0)
    seen = np.zeros((80, 100), dtype=bool)
    for _ in range(400):
        rows, columns = patch(80, 100, rng)
        seen[rows, columns] = True
        assert seen[rows, columns].shape == (PATCH, PATCH)
    assert seen.any(axis=0).all() and seen.any(axis=1).all()
    assert np.ones((20, 30))[patch(20, 30, rng)].shape == (20, 30)


def test_the_hinge_rewards_margins_only() -> None:
    right = [torch.full((1, 1, 2, 2), 3.0)], [torch.full((1, 1, 2, 2), -3.0)]
    assert discriminator_loss(*right) == 0.0
    assert discriminator_loss(right[1], right[0]) == 8.0
    assert generator_loss(right[0]) == -3.0


def test_a_light_aware_discriminator_learns_whether_a_picture_fits_its_light() -> None:
    """Pictures are their condition's shading or another's: only a discriminator that sees it can tell."""

    def accuracy(conditions: int) -> float:
        torch.manual_seed(0)
        judge = Discriminator(conditions)
        optimiser = Adam(judge.parameters(), 2e-3)
        right = 0.0
        for step in range(40):
            light, other = torch.rand(2, 4, 2, 1, 1).expand(2, 4, 2, 32, 32)
            real, fake = (shade.mean(1, keepdim=True).expand(-1, 3, -1, -1) for shade in (light, other))
            condition = light if conditions else None
            scores = [judge(picture, condition) for picture in (real, fake)]
            loss = discriminator_loss(*scores)
            optimiser.forget()
            loss.backward()
            optimiser.step()
            if step >= 30:
                real_score, fake_score = (torch.stack([s.mean(dim=(1, 2, 3)) for s in of]).mean(0) for of in scores)
                right += float((real_score > fake_score).float().mean()) / 10
        return right

    assert accuracy(2) > 0.85
    assert accuracy(0) < 0.7
