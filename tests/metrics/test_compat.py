"""What official evaluators compute, each restated here with other libraries than the product uses."""

from __future__ import annotations

import math
from collections.abc import Callable

import kornia
import numpy as np
import pytest
import torch
from PIL import Image
from scipy.optimize import minimize, minimize_scalar
from torch.nn.functional import avg_pool2d, conv2d, pad
from torchmetrics.functional.image import peak_signal_noise_ratio, structural_similarity_index_measure

from handbench.metrics import Pair, metric
from handbench.metrics.compat import ENTRIES, palm

NAMES = [entry.name for entry in ENTRIES]
Lpips = Callable[..., torch.Tensor]


def pair(height: int = 72, width: int = 56, seed: int = 3) -> Pair:
    """A premultiplied truth in a soft ellipse, partly above 1, and a darker, noisy prediction a bit to the right."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width]
    away = (np.hypot((y / height - 0.5) / 0.38, (x / width - centre) / 0.33) for centre in (0.45, 0.48))
    mask, own = (np.clip((1.0 - distance) * 12 + 0.5, 0, 1) for distance in away)
    waves = np.abs(0.5 + 0.6 * np.stack([np.sin(x / 5.0), np.cos(y / 4.0), np.sin((x + y) / 7.0)], axis=-1))
    truth = waves * mask[..., None]
    prediction = np.abs(waves * (0.7, 0.8, 0.9) + rng.normal(0, 0.05, waves.shape)) * own[..., None]
    return Pair(*(a.astype(np.float32) for a in (prediction, truth, mask)), prediction_alpha=own.astype(np.float32))


def score(name: str, of: Pair) -> float:
    (found,) = metric(name)([of])
    assert found.value is not None, found.reason
    return found.value


def encode(linear: np.ndarray) -> torch.Tensor:
    """sRGB by kornia, (1, 3, H, W), of a linear image that is clipped first."""
    clipped = torch.from_numpy(np.clip(np.asarray(linear, np.float64), 0, 1)).permute(2, 0, 1)[None]
    return kornia.color.linear_rgb_to_rgb(clipped)


def over_white(image: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    return image.astype(np.float64) + 1.0 - alpha.astype(np.float64)[..., None]


def uniform_ssim(a: torch.Tensor, b: torch.Tensor, data_range: float) -> torch.Tensor:
    """SSIM map of the 7 x 7 windows that lie within, with sample covariance, by average pooling."""
    mean_a, mean_b = avg_pool2d(a, 7, 1), avg_pool2d(b, 7, 1)
    norm = 49 / 48
    var_a = norm * (avg_pool2d(a * a, 7, 1) - mean_a**2)
    var_b = norm * (avg_pool2d(b * b, 7, 1) - mean_b**2)
    covariance = norm * (avg_pool2d(a * b, 7, 1) - mean_a * mean_b)
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    return (2 * mean_a * mean_b + c1) * (2 * covariance + c2) / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))


def five_scales(a: torch.Tensor, b: torch.Tensor) -> float:
    """MS-SSIM (Wang et al., Asilomar 2003, Eq. 7), mean over channels; zeros surround odd sides at halving."""
    line = torch.exp(-((torch.arange(11, dtype=torch.float64) - 5) ** 2) / (2 * 1.5**2))
    window = torch.outer(line, line)[None, None] / line.sum() ** 2
    a, b = a[0][:, None], b[0][:, None]
    product = torch.ones(3, dtype=torch.float64)
    for level, weight in enumerate((0.0448, 0.2856, 0.3001, 0.2363, 0.1333)):
        ma, mb, aa, bb, ab = (conv2d(image, window) for image in (a, b, a * a, b * b, a * b))
        factor = (2 * (ab - ma * mb) + 0.03**2) / (aa - ma**2 + bb - mb**2 + 0.03**2)
        if level == 4:
            factor = factor * (2 * ma * mb + 0.01**2) / (ma**2 + mb**2 + 0.01**2)
        product = product * factor.mean(dim=(1, 2, 3)).clamp_min(0) ** weight
        a, b = (avg_pool2d(image, 2, padding=[side % 2 for side in image.shape[2:]]) for image in (a, b))
    return float(product.mean())


@pytest.mark.parametrize("size", [(72, 56), (56, 72), (64, 64)])
@pytest.mark.parametrize("saved", ["rounded", "truncated"])
def test_palm(size: tuple[int, int], saved: str, official_lpips: Lpips) -> None:
    """The pictures go through PIL and flat lists of pixels as in the evaluator, so width and height are swapped."""
    p, option = pair(*size), f":codes={saved}"
    drawn, recorded = (encode(i)[0].permute(1, 2, 0) * 255 for i in
                       (over_white(p.prediction, p.prediction_alpha), p.truth))  # fmt: skip
    # `get_rgb_image_` of the renderer: times 255, astype(np.uint8); a thousandth of a code is rounding, not darkness
    codes = [(drawn.round() if saved == "rounded" else drawn + 1e-3).numpy().astype(np.uint8),
             recorded.round().numpy().astype(np.uint8)]  # fmt: skip
    mask_codes = np.round(p.mask * 255).astype(np.uint8)
    prediction, truth = (Image.fromarray(c) for c in codes)
    first, second = truth.size  # (width, height), which the evaluator takes for (height, width)

    flat_prediction, flat_truth = (torch.tensor(np.array(i)).view(-1, 3).double() / 255 for i in (prediction, truth))
    hand = torch.tensor(mask_codes == 255).view(-1)
    flat_truth[~hand] = 1.0
    error = ((flat_prediction - flat_truth) ** 2)[hand].mean()
    assert score("palm-official-psnr" + option, p) == pytest.approx(float(-10 * torch.log10(error)), abs=1e-5)

    rows, columns = torch.nonzero(hand.view(first, second), as_tuple=True)
    cut = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    boxes = [i.view(first, second, 3)[cut].permute(2, 0, 1)[None] for i in (flat_prediction, flat_truth)]
    assert score("palm-official-ssim" + option, p) == pytest.approx(float(uniform_ssim(*boxes, 2.0).mean()), abs=1e-6)
    twice = [2 * (2 * box - 1) - 1 for box in boxes]
    assert score("palm-official-lpips" + option, p) == pytest.approx(float(official_lpips("vgg", *twice)), abs=1e-5)


def test_palm_sees_the_plain_box_of_a_square_picture_only() -> None:
    """Rows are wrapped where width and height differ: the mask's box then reaches from side to side."""
    square, oblong = pair(64, 64), pair(72, 56)
    rows, columns = np.nonzero(np.round(square.mask * 255) == 255)
    assert palm._box(square, "rounded", 1)[0].shape[:2] == (np.ptp(rows) + 1, np.ptp(columns) + 1)
    assert palm._box(oblong, "rounded", 1)[0].shape[1] > 0.95 * 72


def test_pictures_of_8_bits_are_not_truncated_once_more() -> None:
    """What a PNG held is a code still after its way through linear single precision."""
    codes = np.arange(256, dtype=np.float64).repeat(3).reshape(16, 16, 3) / 255
    linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4).astype(np.float32)
    p = Pair(linear, linear, np.ones((16, 16)))
    for saved in ("rounded", "truncated"):
        assert np.abs(palm._pictures(p, saved).prediction - codes).max() < 1e-12


@pytest.mark.parametrize("clip", ["truth", "both"])
def test_goliath(clip: str) -> None:
    """The loader clamps the truth; nothing clamps the prediction, which here is brighter than white in places."""
    p, option = pair(), f":clip={clip}"
    prediction = np.clip(1.3 * p.prediction, 0, 1 if clip == "both" else None)
    assert (1.3 * p.prediction).max() > 1.1
    p = Pair(np.float32(1.3) * p.prediction, p.truth, p.mask)
    images = [torch.from_numpy(i).double().permute(2, 0, 1)[None] for i in (prediction, np.clip(p.truth, 0, 1))]
    mask = torch.from_numpy(p.mask > 0).double()[None, None]
    masked = [255 * image * mask for image in images]
    assert score("goliath-psnr" + option, p) == pytest.approx(
        float(peak_signal_noise_ratio(*masked, data_range=255.0)), abs=1e-5
    )
    padded = [pad(image, (5, 5, 5, 5)) for image in images]
    similarity = kornia.metrics.ssim(*padded, 11, padding="valid")
    expected = (similarity * mask).sum() / mask.expand_as(similarity).sum()
    assert score("goliath-ssim" + option, p) == pytest.approx(float(expected), abs=1e-5)


def test_goliath_makes_a_highlight_that_is_right_pay() -> None:
    p = pair()
    right = Pair(p.truth, p.truth, p.mask)
    assert p.truth.max() > 1 and score("goliath-psnr", right) < 45 and score("goliath-ssim", right) < 0.999
    assert score("goliath-psnr:clip=both", right) == 100 and score("goliath-ssim:clip=both", right) == pytest.approx(1)
    dim = Pair(0.5 * p.truth, 0.5 * p.truth, p.mask)
    assert score("goliath-psnr", dim) == 100 and score("goliath-ssim", dim) == pytest.approx(1)


def test_a_mask_of_15_percent_is_worth_8_decibels() -> None:
    """Same error, full-frame mean against mean in the mask: 10 log10(1 / 0.15) = 8.24 dB."""
    rng = np.random.default_rng(0)
    mask = np.zeros((40, 50))
    mask[10:30, 10:25] = 1  # 300 of 2,000 pixels
    truth = rng.uniform(0.1, 0.9, (40, 50, 3)) * mask[..., None]
    p = Pair(truth + rng.normal(0, 0.02, truth.shape) * mask[..., None], truth, mask)
    difference = score("goliath-psnr", p) - score("psnr:space=linear", p)
    assert difference == pytest.approx(10 * math.log10(1 / 0.15), abs=1e-6)
    uhm = score("uhm-psnr", p) - score("psnr", p)
    assert uhm == pytest.approx(8.2390874, abs=1e-6)


def test_harp(official_lpips: Lpips) -> None:
    p = pair(180, 170)
    prediction, truth = (encode(over_white(i, a)) for i, a in ((p.prediction, p.prediction_alpha), (p.truth, p.mask)))
    assert score("harp-l1", p) == pytest.approx(float((prediction - truth).abs().mean()), abs=1e-7)
    assert score("harp-lpips", p) == pytest.approx(float(official_lpips("alex", prediction, truth)), abs=1e-5)
    assert score("harp-ms-ssim", p) == pytest.approx(five_scales(prediction, truth), abs=1e-5)
    ours, theirs = p.prediction_alpha >= 0.5, p.mask >= 0.5
    assert score("harp-iou", p) == pytest.approx((ours & theirs).sum() / (ours | theirs).sum())
    assert score("harp-iou", p) < 0.99
    (small,) = metric("harp-ms-ssim")([pair(180, 160)])
    assert small.value is None and "160" in small.reason


def test_uhm(official_lpips: Lpips) -> None:
    p = pair()
    mask = torch.from_numpy((p.prediction_alpha > 0.5) & (p.mask > 0.5))[None, None]
    prediction, truth = encode(p.prediction), encode(p.truth)
    black = (prediction * mask, truth * mask)
    assert score("uhm-psnr", p) == pytest.approx(float(peak_signal_noise_ratio(*black, data_range=1.0)), abs=1e-5)
    counted, similarity = structural_similarity_index_measure(*black, data_range=1.0, return_full_image=True)
    assert score("uhm-ssim", p) == pytest.approx(float(similarity[..., 5:-5, 5:-5].mean()), abs=1e-6)
    assert score("uhm-ssim:torchmetrics=1.4.2", p) == pytest.approx(float(counted), abs=1e-6)
    grey = ((2 * prediction - 1) * mask, (2 * truth - 1) * mask)
    assert score("uhm-lpips", p) == pytest.approx(float(official_lpips("alex", *grey)), abs=1e-5)
    assert score("uhm-iou", p) == pytest.approx(100 * score("harp-iou", p), abs=0.5)


def test_stanford_orb(official_lpips: Lpips) -> None:
    p = pair()
    mask = torch.from_numpy((p.mask > 0.5).astype(np.float64))[None, None]
    hand = kornia.morphology.erosion(mask, torch.ones(5, 5, dtype=torch.float64))[0, 0].numpy() > 0.5
    assert 0 < hand.sum() < (p.mask > 0.5).sum()
    prediction, truth = (i.astype(np.float64) * hand[..., None] for i in (p.prediction, p.truth))

    def fitted(gain: float) -> tuple[np.ndarray, np.ndarray]:
        columns = [
            np.linalg.lstsq(gain * prediction[hand][:, [c]], gain * truth[hand][:, c], rcond=None)[0][0]
            for c in range(3)
        ]
        return gain * prediction * columns, gain * truth

    gain = float(encode(truth).mean() / np.clip(truth, 0, 1).mean())
    bright = [torch.from_numpy(np.clip(i, 0, 4)) for i in fitted(gain)]
    assert gain > 1.1 and bright[1].max() > 1
    expected = peak_signal_noise_ratio(*bright, data_range=1.0)
    assert score("stanford-orb-psnr-hdr", p) == pytest.approx(float(expected), abs=1e-5)
    encoded = [encode(i) for i in fitted(1.0)]
    expected = peak_signal_noise_ratio(*encoded, data_range=1.0)
    assert score("stanford-orb-psnr-ldr", p) == pytest.approx(float(expected), abs=1e-5)
    similarity = kornia.metrics.ssim(*encoded, window_size=3)
    assert score("stanford-orb-ssim", p) == pytest.approx(float(similarity.mean()), abs=1e-6)
    twice = [2 * kornia.color.linear_rgb_to_rgb(i) - 1 for i in encoded]
    assert score("stanford-orb-lpips", p) == pytest.approx(float(official_lpips("vgg", *twice)), abs=1e-5)


@pytest.mark.parametrize("size", [(72, 56), (24, 30)])
def test_uhm_counts_the_border_since_torchmetrics_1_4_2(size: tuple[int, int]) -> None:
    """A noisy picture that fills the frame: the border is mirrored there, so it is more alike."""
    rng = np.random.default_rng(1)
    truth = rng.uniform(0.1, 0.9, (*size, 3))
    p = Pair((truth + rng.normal(0, 0.1, truth.shape)).clip(0), truth, np.ones(size))
    counted = structural_similarity_index_measure(encode(p.prediction), encode(p.truth), data_range=1.0)
    assert score("uhm-ssim:torchmetrics=1.4.2", p) == pytest.approx(float(counted), abs=1e-6)
    assert abs(score("uhm-ssim", p) - float(counted)) > 1e-3


@pytest.mark.parametrize("quantity", ["psnr", "ssim", "lpips"])
def test_uhm_has_no_value_for_a_prediction_that_misses_the_hand(quantity: str) -> None:
    p = pair()
    missed = Pair(p.prediction, p.truth, p.mask, prediction_alpha=(p.mask == 0).astype(np.float32))
    (found,) = metric(f"uhm-{quantity}")([missed])
    assert found.value is None and "misses the hand, which the official code calls perfect" in found.reason


@pytest.mark.parametrize("quantity", ["psnr-hdr", "psnr-ldr", "ssim", "lpips"])
def test_stanford_orb_stops_at_a_negative_value_in_its_mask(quantity: str) -> None:
    p, name = pair(), f"stanford-orb-{quantity}"
    rows, columns = np.nonzero(p.mask > 0.99)
    middle = len(rows) // 2
    for where, change, count in (
        ((rows[middle], columns[middle], 1), -1e-4, "1 negative value "),
        (np.s_[..., 0], -p.truth[..., 0], "negative values "),
        (np.s_[...], -p.truth, "negative values "),
    ):
        wrong = p.truth.copy()
        wrong[where] = change
        (found,) = metric(name)([Pair(wrong, p.truth, p.mask)])
        assert found.value is None and f"{count}in the eroded mask: the official code stops" in found.reason
    outside = np.where(p.mask[..., None] > 0, p.prediction, np.float32(-0.5))
    assert score(name, Pair(outside, p.truth, p.mask)) == score(name, p)


def test_stanford_orb_does_not_erode_from_the_border() -> None:
    truth = np.full((20, 30, 3), 0.5, np.float32)
    prediction = truth.copy()
    prediction[0] = 0.0  # the factor that fits it best is 1
    expected = -10 * math.log10(float(encode(truth)[0, 0, 0, 0]) ** 2 / 20)
    found = score("stanford-orb-psnr-ldr", Pair(prediction, truth, np.ones((20, 30))))
    assert found == pytest.approx(expected, abs=1e-4)


def test_stanford_orb_scores_a_black_prediction_as_a_grey_one() -> None:
    p = pair()
    black = Pair(np.zeros_like(p.truth), p.truth, p.mask)
    hand = kornia.morphology.erosion(torch.from_numpy((p.mask > 0.5).astype(np.float32))[None, None], torch.ones(5, 5))
    inside = hand[0, 0].numpy()[..., None]
    error = np.mean((0.5 * inside - (encode(p.truth * inside)[0].permute(1, 2, 0)).numpy()) ** 2)
    assert score("stanford-orb-psnr-ldr", black) == pytest.approx(-10 * math.log10(error), abs=1e-5)


def test_objects_with_lighting(official_lpips: Lpips) -> None:
    p = pair()
    hand = p.mask > 0.5
    truth = np.round(255 * np.clip(p.truth.astype(np.float64), 0, 1) ** (1 / 2.2)) / 255
    truth32, linear = truth.astype(np.float32), p.prediction.astype(np.float32)
    use = hand & (truth32.max(-1) < 1)

    def tone(image: np.ndarray, exposure: float) -> np.ndarray:
        return np.clip(np.maximum(image * 2.0**exposure, 0) ** (1 / 2.2), 0, 1)

    def off(image: np.ndarray, exposure: float) -> float:
        return float(np.abs(tone(image, exposure) - truth32[use]).mean())

    dark = linear[use].min(-1)
    exposure = minimize_scalar(lambda e: off(linear[use], e), (-10, np.log2(0.95**2.2 / dark[dark > 0].min()))).x
    grid = np.linspace(-4, 4, 801)
    assert exposure == pytest.approx(grid[np.argmin([off(linear[use], e) for e in grid])], abs=0.02)
    balance = minimize(
        lambda b: off(linear[use] * b, exposure), np.ones(3, np.float32), bounds=[(0.5, 2.0)] * 3
    ).x.astype(np.float32)
    prediction = tone(linear * balance, exposure)

    expected = peak_signal_noise_ratio(*(torch.from_numpy(i[hand]) for i in (prediction, truth)), data_range=1.0)
    assert score("objects-with-lighting-psnr", p) == pytest.approx(float(expected), abs=1e-4)
    black = [
        torch.from_numpy(np.pad(i * hand[..., None], ((3, 3), (3, 3), (0, 0)), "symmetric")).double().permute(2, 0, 1)
        for i in (prediction, truth)
    ]
    similarity = uniform_ssim(black[0][None], black[1][None], 1.0)[0].permute(1, 2, 0).numpy()
    assert score("objects-with-lighting-ssim", p) == pytest.approx(similarity[hand].mean(), abs=1e-4)
    grey = [torch.from_numpy((2 * i - 1) * hand[..., None]).permute(2, 0, 1)[None] for i in (prediction, truth)]
    expected = official_lpips("alex", *grey, spatial=True).numpy()[hand].mean()
    assert score("objects-with-lighting-lpips", p) == pytest.approx(float(expected), abs=1e-4)


@pytest.mark.parametrize("name", NAMES)
def test_a_perfect_prediction(name: str) -> None:
    p = pair(180, 170)
    perfect = Pair(p.truth, p.truth, p.mask, prediction_alpha=p.mask)
    declared, found = metric(name).perfect, score(name, perfect)
    if declared is not None:
        assert found == pytest.approx(declared, abs=1e-6)
    elif name.startswith("palm"):  # the truth is white at the soft edge
        expected = {"psnr": found == 100, "ssim": 0.9 < found < 0.99, "lpips": 0 < found < 0.2}
        assert expected[name.rpartition("-")[2]]
    elif name == "stanford-orb-ssim":
        assert 0.9999 < found < 1
    elif name.startswith("goliath"):  # the truth is clamped, the prediction is not
        assert {"psnr": 25 < found < 45, "ssim": 0.95 < found < 0.999}[name.rpartition("-")[2]]
    else:  # the truth has 8 bits, the prediction has not
        assert {"psnr": found > 45, "ssim": found > 0.99, "lpips": found < 0.01}[name.rpartition("-")[2]]


MASKED = [
    "palm-official-psnr",
    "goliath-psnr",
    *(f"uhm-{q}" for q in ("psnr", "ssim", "lpips", "iou")),
    *(f"stanford-orb-{q}" for q in ("psnr-hdr", "psnr-ldr", "ssim", "lpips")),
    *(f"objects-with-lighting-{q}" for q in ("psnr", "ssim", "lpips")),
]


@pytest.mark.parametrize("name", MASKED)
def test_what_is_drawn_outside_the_mask_changes_nothing(name: str) -> None:
    p = pair()
    garbage = np.where(p.mask[..., None] > 0, p.prediction, np.float32(0.9))
    assert score(name, Pair(garbage, p.truth, p.mask, prediction_alpha=p.prediction_alpha)) == score(name, p)


@pytest.mark.parametrize("name", ["palm-official-ssim", "harp-l1", "harp-lpips", "goliath-ssim"])
def test_what_is_drawn_outside_the_mask_costs_where_nothing_is_masked(name: str) -> None:
    p = pair()
    garbage = np.where(p.mask[..., None] > 0, p.prediction, np.float32(0.9))
    worse = Pair(garbage, p.truth, p.mask, prediction_alpha=np.ones_like(p.mask))
    assert abs(score(name, worse) - score(name, p)) > 1e-3


@pytest.mark.parametrize("quantity", ["psnr-hdr", "psnr-ldr", "ssim", "lpips"])
def test_stanford_orb_forgives_the_colour_of_light(quantity: str) -> None:
    p = pair()
    tinted = Pair(p.prediction * np.float32([3.0, 0.5, 1.5]), p.truth, p.mask)
    assert score(f"stanford-orb-{quantity}", tinted) == pytest.approx(score(f"stanford-orb-{quantity}", p), abs=1e-4)


def test_objects_with_lighting_forgives_exposure_and_some_colour() -> None:
    p = pair()
    plain = score("objects-with-lighting-psnr", p)
    dark = Pair(p.prediction * np.float32(0.01), p.truth, p.mask)
    tinted = Pair(p.prediction * np.float32([1.3, 1.0, 0.8]), p.truth, p.mask)
    too_far = Pair(p.prediction * np.float32([8.0, 1.0, 0.1]), p.truth, p.mask)
    assert score("objects-with-lighting-psnr", dark) == pytest.approx(plain, abs=0.3)
    assert score("objects-with-lighting-psnr", tinted) == pytest.approx(plain, abs=0.3)
    assert score("objects-with-lighting-psnr", too_far) < plain - 3


@pytest.mark.parametrize("name", NAMES)
def test_what_cannot_be_scored_has_a_reason(name: str) -> None:
    p = pair(180, 170)
    empty = Pair(p.prediction, p.truth, np.zeros_like(p.mask), prediction_alpha=np.zeros_like(p.mask))
    wild = Pair(np.full_like(p.prediction, np.nan), p.truth, p.mask, prediction_alpha=p.mask)
    black = Pair(np.zeros_like(p.prediction), p.truth, p.mask, prediction_alpha=p.mask)
    for found in metric(name)([wild]):
        assert found.value is None and "non-finite prediction" in found.reason
    for found in metric(name)([empty]):
        if name not in ("harp-l1", "harp-lpips", "harp-ms-ssim"):
            assert found.value is None and "mask" in found.reason
    for found in metric(name)([black]):
        assert found.value is not None or "exposure" in found.reason


@pytest.mark.parametrize("name", ["harp-iou", "uhm-iou"])
def test_overlap_needs_the_predictions_alpha(name: str) -> None:
    p = pair()
    (found,) = metric(name)([Pair(p.prediction, p.truth, p.mask)])
    assert found.value is None and "alpha" in found.reason


def test_a_prediction_without_alpha_is_taken_to_cover_what_the_truth_covers() -> None:
    p = pair()
    silent, said = Pair(p.prediction, p.truth, p.mask), Pair(p.prediction, p.truth, p.mask, prediction_alpha=p.mask)
    for name in ("palm-official-ssim", "harp-l1", "uhm-psnr"):
        assert score(name, silent) == score(name, said)
        assert "coverage:own-else-truth" in metric(name).signature.split("|")


def test_signatures_say_what_decides_the_value() -> None:
    for name, terms in {
        "palm-official-ssim": {"rows:wrapped-at-height", "background:white", "range:2", "window:uniform7"},
        "palm-official-lpips": {"net:vgg", "normalised:twice"},
        "goliath-psnr": {"clip:truth", "clipped-to:0-255", "region:full", "masked:difference", "peak:255", "v2"},
        "goliath-ssim:clip=both": {"clip:both", "padding:zero", "space:linear"},
        "uhm-ssim": {"torchmetrics:1.4.1"},
        "uhm-ssim:torchmetrics=1.4.2": {"torchmetrics:1.4.2"},
        "palm-official-psnr:codes=truncated": {"codes:truncated"},
        "objects-with-lighting-ssim": {"border:mirrored"},
        "stanford-orb-psnr-hdr": {"negative:none", "eroded:5x5", "scale:rgb", "clip:0-4", "at-least:uniform-0.5"},
        "objects-with-lighting-lpips": {"exposure:search", "balance:0.5-2", "space:gamma2.2", "map:spatial"},
        "harp-lpips": {"net:alex", "normalised:never", "background:white"},
    }.items():
        assert terms <= set(metric(name).signature.split("|")), name
