"""PSNR and SSIM against scikit-image, and SSIM against the formula written out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from handbench.metrics import Pair, metric
from handbench.scene.colour import srgb

WANG = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "channel_axis": -1, "data_range": 1.0}


def images(seed: int, height: int = 37, width: int = 29) -> Pair:
    """Seeded noise that leaves [0, 1] on both sides, and a mask of a random box with a hole."""
    rng = np.random.default_rng(seed)
    prediction, truth = rng.normal(0.5, 0.4, (2, height, width, 3)).astype(np.float32)
    mask = np.zeros((height, width), np.float32)
    top, left = rng.integers(0, height - 1), rng.integers(0, width - 1)
    mask[top : top + rng.integers(2, height), left : left + rng.integers(2, width)] = 1
    mask[top + 1, left + 1] = 0
    return Pair(prediction, truth, mask)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(["srgb", "linear"]))
def test_psnr_is_that_of_scikit_image(seed: int, space: str) -> None:
    p = images(seed)
    view = srgb if space == "srgb" else lambda x: x
    prediction, truth, inside = view(p.prediction), view(p.truth), p.mask > 0.5
    full, mask = (metric(f"psnr:space={space},region={region}")([p])[0].value for region in ("full", "mask"))
    assert full == pytest.approx(peak_signal_noise_ratio(truth, prediction, data_range=1), abs=1e-4)
    assert mask == pytest.approx(peak_signal_noise_ratio(truth[inside], prediction[inside], data_range=1), abs=1e-4)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([37, 66, 150]))
def test_ssim_in_a_region_is_the_whole_images_map_there(seed: int, height: int) -> None:
    """Neither the cut nor the bands must show: also where the mask touches the border of the image."""
    p = images(seed, height)
    prediction, truth = (srgb(image.astype(np.float64)) for image in (p.prediction, p.truth))
    mean, whole = structural_similarity(prediction, truth, full=True, **WANG)
    rows, columns = np.nonzero(p.mask)
    box = np.s_[max(rows.min() - 8, 0) : rows.max() + 9, max(columns.min() - 8, 0) : columns.max() + 9]
    assert metric("ssim")([p])[0].value == pytest.approx(whole[p.mask > 0.5].mean(), abs=1e-9)
    assert metric("ssim:region=box")([p])[0].value == pytest.approx(whole[box].mean(), abs=1e-9)
    assert metric("ssim:region=full")([p])[0].value == pytest.approx(mean, abs=1e-9)


def test_a_box_that_is_the_whole_picture_counts_the_border_and_says_so() -> None:
    p = images(6)
    everywhere = Pair(p.prediction, p.truth, np.ones_like(p.mask))
    box, full = metric("ssim:region=box"), metric("ssim:region=full")
    assert abs(box([everywhere])[0].value - full([everywhere])[0].value) > 1e-3
    assert "border:mirrored" in box.signature and "border:left-out" in full.signature


def test_ssim_is_the_formula_of_the_paper() -> None:
    """Wang et al. 2004, Eq. 13-16, one window written out in float64: 11 x 11 Gaussian, K1 = .01, K2 = .03, L = 1."""
    p = images(4)
    mask = np.zeros_like(p.mask)
    mask[18, 14] = 1
    weights = np.exp(-0.5 * ((np.arange(11) - 5) / 1.5) ** 2)
    window = (np.outer(weights, weights) / weights.sum() ** 2)[..., None]
    x, y = (srgb(image.astype(np.float64))[13:24, 9:20] for image in (p.prediction, p.truth))
    mx, my = (window * x).sum((0, 1)), (window * y).sum((0, 1))
    vx, vy = (window * (x - mx) ** 2).sum((0, 1)), (window * (y - my) ** 2).sum((0, 1))
    covariance = (window * (x - mx) * (y - my)).sum((0, 1))
    expected = (2 * mx * my + 1e-4) * (2 * covariance + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))
    assert metric("ssim")([Pair(p.prediction, p.truth, mask)])[0].value == pytest.approx(expected.mean(), abs=1e-10)


def test_psnr_cap_is_in_the_signature_and_holds() -> None:
    truth = np.full((4, 4, 3), 0.25)
    mask = np.ones((4, 4))
    capped, exact = metric("psnr:space=linear")([Pair(truth + 1e-7, truth, mask), Pair(truth + 1e-2, truth, mask)])
    assert (capped.value, exact.value) == (100.0, pytest.approx(40.0))
    assert "cap:100" in metric("psnr").signature.split("|")
