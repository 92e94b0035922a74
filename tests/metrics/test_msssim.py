"""MS-SSIM against torchmetrics and scikit-image, and how a small hand or a small picture is handled."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from skimage.measure import block_reduce
from skimage.metrics import structural_similarity
from torchmetrics.functional.image import structural_similarity_index_measure

from handbench.metrics import Pair, metric
from handbench.scene.colour import srgb


def pair(height: int, width: int, seed: int = 0) -> Pair:
    """A smooth seeded picture, a noisy prediction of it, and a small mask in the middle."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width] / 16.0
    truth = 0.5 + 0.4 * np.stack([np.sin(x), np.cos(y), np.sin(x + y)], axis=-1)
    mask = np.zeros((height, width))
    mask[height // 2 - 20 : height // 2 + 20, width // 2 - 15 : width // 2 + 15] = 1
    return Pair(truth + 0.15 * rng.standard_normal(truth.shape), truth, mask)


def contrast(a: np.ndarray, b: np.ndarray) -> float:
    images = (torch.from_numpy(image)[None, None] for image in (a, b))
    return structural_similarity_index_measure(*images, data_range=1.0, return_contrast_sensitivity=True)[1].item()


def similarity(a: np.ndarray, b: np.ndarray) -> float:
    settings = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1.0}
    return structural_similarity(a, b, **settings)


def test_it_is_the_papers_of_other_libraries_parts() -> None:
    """Contrast and structure of four scales by torchmetrics, SSIM of the fifth by scikit-image, each without borders.

    (torchmetrics' own MS-SSIM is 1e-4 off: it leaves the fifth scale's border in.) Sides are divisible by 16: of odd
    sides, as of colour, the paper says nothing.
    """
    p = pair(176, 208)
    expected = []
    for channel in range(3):
        a, b = (srgb(image)[..., channel] for image in (p.prediction, p.truth))
        value = 1.0
        for weight in (0.0448, 0.2856, 0.3001, 0.2363):
            value *= contrast(a, b) ** weight
            a, b = (block_reduce(image, 2, np.mean) for image in (a, b))
        expected.append(value * similarity(a, b) ** 0.1333)
    assert 0.3 < np.mean(expected) < 0.98
    assert metric("ms-ssim:region=full")([p])[0].value == pytest.approx(np.mean(expected), abs=1e-6)


def test_a_small_hand_is_seen_in_the_least_square_around_it() -> None:
    p = pair(240, 200)
    cut = np.s_[40:201, 20:181]  # 161 pixels around rows 100 to 140 and columns 85 to 115, and 8 of margin
    alone = Pair(p.prediction[cut], p.truth[cut], p.mask[cut])
    assert metric("ms-ssim")([p]) == metric("ms-ssim:region=full")([alone])


def test_a_small_picture_has_no_value_and_the_reason() -> None:
    score = metric("ms-ssim")([pair(160, 300)])[0]
    assert score.value is None
    assert score.reason == "image of 160x300 pixels is smaller than the 161x161 the metric needs"


def test_an_inverted_picture_is_zero_not_nan() -> None:
    p = pair(176, 176)
    assert metric("ms-ssim:space=linear")([Pair(1 - p.truth, p.truth, p.mask)])[0].value == 0.0
