"""Regions, colour space and alignment, and what is refused at the border."""

from __future__ import annotations

import kornia
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from handbench.metrics import ENTRIES, Family, Pair, metric, scores
from handbench.scene.colour import srgb

LEAST = {
    "psnr": 1,
    "ssim": 11,
    "ms-ssim": 161,
    "lpips-alex": 32,
    "lpips-vgg": 32,
    "dists": 32,
    "flip": 1,
    "hdr-flip": 1,
}
"""Every metric of pictures, and width and height of the smallest it is defined for."""

SPECS = tuple(LEAST)


def test_no_metric_of_pictures_is_left_out() -> None:
    families = [entry.load() for entry in ENTRIES]
    assert {family.name for family in families if isinstance(family, Family)} == set(SPECS)


def pair(seed: int = 0, size: tuple[int, int] = (48, 40), noise: float = 0.05, spec: str = "psnr") -> Pair:
    """A seeded textured truth in an ellipse, black outside, and a noisy prediction of it, large enough for a metric."""
    size = max(size[0], LEAST[spec]), max(size[1], LEAST[spec])
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
    p = pair(spec=spec)
    best = {"psnr": 100.0, "ssim": 1.0, "ms-ssim": 1.0}.get(spec, 0.0)
    assert metric(spec)([Pair(p.truth, p.truth, p.mask)])[0].value == pytest.approx(best, abs=1e-12)
    assert metric(spec).perfect == best


@pytest.mark.parametrize("spec", SPECS)
def test_a_worse_image_scores_worse_and_order_changes_nothing(spec: str) -> None:
    chosen = metric(spec)
    pairs = [pair(noise=n, spec=spec) for n in (0.01, 0.05, 0.2, 0.5)] + [pair(3, size=(64, 33), spec=spec)]
    found = chosen(pairs)
    values = [s.value for s in found[:4]]
    assert values == sorted(values, reverse=chosen.higher_is_better)
    order = [3, 0, 4, 2, 1]
    assert chosen([pairs[i] for i in order]) == [found[i] for i in order]
    assert [chosen([p])[0] for p in pairs] == found


@pytest.mark.parametrize("spec", SPECS)
def test_swapping_prediction_and_truth_changes_nothing(spec: str) -> None:
    p = pair(spec=spec)
    a, b = metric(spec)([p, Pair(p.truth, p.prediction, p.mask)])
    assert a.value == pytest.approx(b.value, rel=1e-5)


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("scale", ["scalar", "rgb"])
def test_alignment_recovers_a_scaled_prediction(spec: str, scale: str) -> None:
    p = pair(spec=spec)
    factor = np.array([0.2, 3.0, 40.0]) if scale == "rgb" else 17.0
    exact = Pair(p.truth * factor, p.truth, p.mask)
    perfect, noisy, scaled = metric(f"{spec}:scale={scale}")([exact, p, Pair(p.prediction * factor, p.truth, p.mask)])
    assert perfect.value == pytest.approx(metric(spec).perfect, abs=1e-6)
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
    p = pair(spec=spec)
    prediction = p.prediction.copy()
    prediction.flat[:12] = bad  # outside the mask: still a failure of the method
    first, second = metric(spec)([Pair(prediction, p.truth, p.mask), p])
    assert (first.value, first.reason) == (None, "non-finite prediction: 12 values")
    assert second.value is not None


@pytest.mark.parametrize("spec", SPECS)
def test_empty_and_one_pixel_masks(spec: str) -> None:
    p = pair(spec=spec)
    empty, corner = np.full_like(p.mask, 0.5), np.zeros_like(p.mask)
    corner[0, -1] = 1
    none, one = metric(spec)([Pair(p.prediction, p.truth, empty), Pair(p.prediction, p.truth, corner)])
    assert (none.value, none.reason) == (None, "empty mask: no pixel with alpha > 0.5")
    assert one.value is not None
    full = metric(f"{spec}:region=full")([Pair(p.prediction, p.truth, empty)])[0]
    assert full.value is not None


@pytest.mark.parametrize(("spec", "least"), LEAST.items())
def test_the_smallest_image_a_metric_is_defined_for(spec: str, least: int) -> None:
    ones = np.ones((least, least, 3))
    assert metric(spec)([Pair(0.5 * ones, ones, ones[..., 0])])[0].value is not None
    if least > 1:
        small = Pair(ones[1:], ones[1:], ones[1:, :, 0])
        reason = f"image of {least - 1}x{least} pixels is smaller than the {least}x{least} the metric needs"
        assert metric(spec)([small])[0].reason == reason


def test_several_metrics_together_say_what_each_says_alone() -> None:
    """What they share of a pair is computed once, and no metric may spoil it for the next."""
    specs = ["lpips-alex", "ssim", "psnr", "ssim:region=full", "flip", "psnr:scale=rgb", "ms-ssim", "psnr:space=linear"]
    metrics = [metric(spec) for spec in specs]
    pairs = [pair(spec="ms-ssim"), pair(5), pair(6, size=(180, 200), noise=0.3)]
    rows = scores(metrics, iter(pairs))
    assert rows == [[chosen([p])[0] for chosen in metrics] for p in pairs]
    assert scores(metrics[::-1], pairs) == [row[::-1] for row in rows]


@settings(max_examples=25, deadline=None)
@given(st.data())
def test_pixels_outside_the_region_never_count(data: st.DataObject) -> None:
    """Scribbling 19 or more pixels beyond the mask (8 of margin, 10 of FLIP's filter) changes no mask or box score."""
    p = pair(size=(60, 50))
    row, column = data.draw(st.integers(0, 59)), data.draw(st.integers(0, 49))
    mask = np.zeros_like(p.mask)
    mask[max(row - 2, 0) : row + 3, column : column + 4] = 1
    near = np.zeros_like(p.mask, dtype=bool)
    near[max(row - 20, 0) : row + 21, max(column - 18, 0) : column + 22] = True
    scribbled = np.where(near[..., None], p.prediction, 7.0)
    for spec in ("psnr", "psnr:region=box", "ssim", "ssim:region=box", "flip", "flip:region=box", "hdr-flip"):
        a, b = metric(spec)([Pair(p.prediction, p.truth, mask), Pair(scribbled, p.truth, mask)])
        assert a.value == pytest.approx(b.value, abs=1e-9), spec


@pytest.mark.parametrize(
    ("scale", "dark", "told"), [("scalar", "rgb", "truth"), ("rgb", "rgb", "truth"), ("rgb", "g", "truth's green")]
)
@pytest.mark.parametrize("spec", ["psnr", "ssim", "lpips-alex", "hdr-flip"])
def test_a_truth_that_is_black_has_no_fitted_score(spec: str, scale: str, dark: str, told: str) -> None:
    """Any prediction would be scaled to it: noise would score as the truth does."""
    p = pair(spec=spec)
    truth = p.truth * [name not in dark for name in "rgb"]
    plain, fitted = scores([metric(spec), metric(f"{spec}:scale={scale}")], [Pair(p.prediction, truth, p.mask)])[0]
    assert plain.value is not None
    assert fitted.reason == f"the {told} is black in the mask: there is nothing to fit a scale to"
