"""The sRGB curve against values that are worked out elsewhere, its inverse, and its differentiable twin."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from handbench.scene.colour import eight_bit, linear, srgb, unclipped_srgb


def test_the_curve_has_the_values_of_the_standard() -> None:
    # middle grey of the standard: code 118 of 255 is 0.1812 of the light; 12.92 x below the knee
    assert eight_bit(np.array([-1.0, 0.0, 0.1812, 1.0, 7.0])).tolist() == [0, 0, 118, 255, 255]
    assert srgb(np.array([0.001])) == pytest.approx(0.01292, abs=1e-15)


def test_linear_undoes_it() -> None:
    x = np.linspace(0.0, 1.0, 1001)
    assert np.allclose(linear(srgb(x)), x, atol=1e-7)  # the standard's two pieces meet within 1e-7


def test_the_differentiable_curve_is_the_same_up_to_white_and_goes_on() -> None:
    x = np.linspace(0.0, 1.0, 1001)
    assert np.allclose(unclipped_srgb(torch.from_numpy(x)).numpy(), srgb(x), atol=1e-12)
    beyond = torch.tensor([-0.5, 2.0], dtype=torch.float64, requires_grad=True)
    shown = unclipped_srgb(beyond)
    shown.sum().backward()
    assert shown.tolist() == pytest.approx([-6.46, 1.055 * 2 ** (1 / 2.4) - 0.055])
    assert beyond.grad is not None and bool((beyond.grad > 0).all())
