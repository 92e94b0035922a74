"""Regions, colour space and alignment, and what is refused at the border."""

from __future__ import annotations

import kornia
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from handbench.errors import InputError
from handbench.metrics import Pair, metric, srgb

SPECS = ("psnr", "ssim", "lpips-alex", "lpips-vgg")


def pair(seed: int = 0, size: tuple[int, int] = (48, 40), noise: float = 0.05) -> Pair:
    """A seeded textured truth in an ellipse, black outside, and a noisy prediction of it."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0 : size[0], 0 : size[1]]
    mask = (((y - size[0] / 2) / (0.35 * size[0])) ** 2 + ((x - size[1] / 2) / (0.3 * size[1])) ** 2 < 1).astype(float)
    truth = rng.random((*size, 3)) * mask[..., None]
    return Pair(np.abs(truth + noise * rng.standard_normal(truth.shape)) * mask[..., None], truth, mask)


def test_srgb_is_the_standard_curve_and_clips() -> None:
    x = np.linspace(0, 1, 10_001)
    oracle = kornia.color.linear_rgb_to_rgb(torch.from_numpy(np.broadcast_to(x, (3, 1, x.size)).copy()))[0, 0].numpy()
    assert np.allclose(srgb(x), oracle, atol=1e-6)
    assert np.allclose(srgb(np.array([-3.0, 0.0, 1.0, 70.0])), [0.0, 0.0, 1.0, 1.0], rtol=0, atol=1e-15)


@pytest.mark.parametrize("spec", SPECS)
def test_identical_images_are_perfect(spec: str) -> None:
    p = pair()
    best = {"psnr": 100.0, "ssim": 1.0}.get(spec, 0.0)
    assert metric(spec)([Pair(p.truth, p.truth, p.mask)])[0].value == pytest.approx(best, abs=1e-12)


@pytest.mark.parametrize("spec", SPECS)
def test_a_worse_image_scores_worse_and_order_changes_nothing(spec: str) -> None:
    chosen = metric(spec)
    pairs = [pair(noise=n) for n in (0.01, 0.05, 0.2, 0.5)] + [pair(3, size=(64, 33))]
    scores = chosen(pairs)
    values = [s.value for s in scores[:4]]
    assert values == sorted(values, reverse=chosen.higher_is_better)
    order = [3, 0, 4, 2, 1]
    assert chosen([pairs[i] for i in order]) == [scores[i] for i in order]
    assert [chosen([p])[0] for p in pairs] == scores


@pytest.mark.parametrize("spec", SPECS)
def test_swapping_prediction_and_truth_changes_nothing(spec: str) -> None:
    p = pair()
    a, b = metric(spec)([p, Pair(p.truth, p.prediction, p.mask)])
    assert a.value == pytest.approx(b.value, rel=1e-5)


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("scale", ["scalar", "rgb"])
def test_alignment_recovers_a_scaled_prediction(spec: str, scale: str) -> None:
    p = pair()
    factor = np.array([0.2, 3.0, 40.0]) if scale == "rgb" else 17.0
    exact = Pair(p.truth * factor, p.truth, p.mask)
    perfect, noisy, scaled = metric(f"{spec}:scale={scale}")([exact, p, Pair(p.prediction * factor, p.truth, p.mask)])
    assert perfect.value == pytest.approx({"psnr": 100.0, "ssim": 1.0}.get(spec, 0.0), abs=1e-6)
    assert scaled.value == pytest.approx(noisy.value, abs=1e-5)
    assert metric(spec)([exact])[0].value != pytest.approx(perfect.value, abs=1e-3)


def test_alignment_is_the_least_squares_fit_in_the_mask() -> None:
    p = pair()
    outside = p.prediction + 5.0 * (1 - p.mask)[..., None]  # must not move the fit
    inside = p.mask > 0.5
    aligned = np.linalg.lstsq(p.prediction[inside].reshape(-1, 1), p.truth[inside].ravel(), rcond=None)[0]
    expected = metric("psnr:space=linear")([Pair(p.prediction * aligned, p.truth, p.mask)])[0].value
    assert metric("psnr:space=linear,scale=scalar")([Pair(outside, p.truth, p.mask)])[0].value == pytest.approx(
        expected
    )


def test_alignment_neither_invents_nor_inverts() -> None:
    p = pair()
    black, negative = np.zeros_like(p.truth), -p.truth
    scores = metric("psnr:space=linear,scale=rgb")([Pair(black, p.truth, p.mask), Pair(negative, p.truth, p.mask)])
    floor = metric("psnr:space=linear")([Pair(black, p.truth, p.mask)])[0]
    assert scores == [floor, floor]


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_non_finite_prediction_is_named_and_counted(spec: str, bad: float) -> None:
    p = pair()
    prediction = p.prediction.copy()
    prediction.flat[:12] = bad  # outside the mask: still a failure of the method
    first, second = metric(spec)([Pair(prediction, p.truth, p.mask), p])
    assert (first.value, first.reason) == (None, "non-finite prediction: 12 values")
    assert second.value is not None


@pytest.mark.parametrize("spec", SPECS)
def test_empty_and_one_pixel_masks(spec: str) -> None:
    p = pair()
    empty, corner = np.full_like(p.mask, 0.5), np.zeros_like(p.mask)
    corner[0, -1] = 1
    none, one = metric(spec)([Pair(p.prediction, p.truth, empty), Pair(p.prediction, p.truth, corner)])
    assert (none.value, none.reason) == (None, "empty mask: no pixel with alpha > 0.5")
    assert one.value is not None
    full = metric(f"{spec}:region=full")([Pair(p.prediction, p.truth, empty)])[0]
    assert full.value is not None


@pytest.mark.parametrize(("spec", "least"), [("psnr", 1), ("ssim", 11), ("lpips-alex", 32), ("lpips-vgg", 32)])
def test_the_smallest_image_a_metric_is_defined_for(spec: str, least: int) -> None:
    ones = np.ones((least, least, 3))
    assert metric(spec)([Pair(0.5 * ones, ones, ones[..., 0])])[0].value is not None
    if least > 1:
        small = Pair(ones[1:], ones[1:], ones[1:, :, 0])
        reason = f"image of {least - 1}x{least} pixels is smaller than the {least}x{least} the metric needs"
        assert metric(spec)([small])[0].reason == reason


def test_what_a_pair_refuses() -> None:
    image, mask = np.zeros((8, 6, 3), np.float32), np.ones((8, 6), np.float32)
    with pytest.raises(InputError, match=r"prediction \(6, 8, 3\) and truth \(8, 6, 3\)"):
        Pair(image.transpose(1, 0, 2), image, mask)
    with pytest.raises(InputError, match=r"mask \(6, 8\) does not fit the truth \(8, 6, 3\)"):
        Pair(image, image, mask.T)
    with pytest.raises(InputError, match=r"expected \(H, W, 3\)"):
        Pair(mask, mask, mask)
    with pytest.raises(InputError, match="prediction has dtype uint8"):
        Pair(image.astype(np.uint8), image, mask)
    with pytest.raises(InputError, match="truth holds 3 values"):
        Pair(image, np.where(np.arange(48).reshape(8, 6, 1) == 5, np.nan, image), mask)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_pixels_outside_the_region_never_count(data: st.DataObject) -> None:
    """Scribbling 14 or more pixels beyond the mask (8 of margin, 5 of SSIM window) changes no mask or box score."""
    p = pair(size=(60, 50))
    row, column = data.draw(st.integers(0, 59)), data.draw(st.integers(0, 49))
    mask = np.zeros_like(p.mask)
    mask[max(row - 2, 0) : row + 3, column : column + 4] = 1
    near = np.zeros_like(p.mask, dtype=bool)
    near[max(row - 16, 0) : row + 17, max(column - 14, 0) : column + 18] = True
    scribbled = np.where(near[..., None], p.prediction, 7.0)
    for spec in ("psnr", "psnr:region=box", "ssim", "ssim:region=box"):
        a, b = metric(spec)([Pair(p.prediction, p.truth, mask), Pair(scribbled, p.truth, mask)])
        assert a.value == pytest.approx(b.value, abs=1e-9), spec
