"""FLIP against the formulas of its paper, and HDR-FLIP as the greatest FLIP of tone-mapped exposures."""

from __future__ import annotations

import math

import flip_evaluator
import numpy as np
import pytest
from scipy.ndimage import convolve

from handbench.metrics import Pair, metric
from handbench.scene.colour import srgb

PPD = 0.7 * 3840 / 0.7 * math.pi / 180
TO_XYZ = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)
WHITE = TO_XYZ @ np.ones(3)


def pair(seed: int = 0, size: tuple[int, int] = (52, 60), bright: float = 1.0) -> Pair:
    """Coloured waves with noise, and a mask that touches the left border."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0 : size[0], 0 : size[1]] / 5.0
    truth = bright * (0.5 + 0.5 * np.stack([np.sin(x), np.cos(y), np.sin(x + y)], axis=-1)) ** 2
    mask = np.zeros(size)
    mask[14:30, 0:22] = 1
    return Pair(np.abs(truth * (1 + 0.3 * rng.standard_normal(truth.shape))), truth, mask)


def opponent(linear: np.ndarray) -> np.ndarray:
    """YCxCz of linear values (H, W, 3)."""
    x, y, z = np.moveaxis(linear @ TO_XYZ.T / WHITE, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def hunt_lab(linear: np.ndarray) -> np.ndarray:
    """CIELAB with Hunt's adjustment of linear values in [0, 1]."""
    t = linear @ TO_XYZ.T / WHITE
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    lightness = 116 * f[..., 1] - 16
    a, b = 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])
    return np.stack([lightness, 0.01 * lightness * a, 0.01 * lightness * b], axis=-1)


def hyab(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    off = one - other
    return np.abs(off[..., 0]) + np.hypot(off[..., 1], off[..., 2])


def filtered(linear: np.ndarray) -> np.ndarray:
    """What the eye resolves (FLIP, Sec. 4.1): contrast sensitivity as sums of Gaussians, clipped to [0, 1]."""
    degrees = np.arange(-10, 11) / PPD
    square = degrees[:, None] ** 2 + degrees**2
    kernels = [
        sum(a * math.sqrt(math.pi / b) * np.exp(-(math.pi**2) * square / b) for a, b in gaussians)
        for gaussians in ([(1, 0.0047)], [(1, 0.0053)], [(34.1, 0.04), (13.5, 0.025)])
    ]
    seen = opponent(linear)
    seen = np.stack([convolve(seen[..., i], k / k.sum(), mode="nearest") for i, k in enumerate(kernels)], axis=-1)
    y = (seen[..., 0] + 16) / 116
    xyz = np.stack([y + seen[..., 1] / 500, y, y - seen[..., 2] / 200], axis=-1) * WHITE
    return np.clip(xyz @ np.linalg.inv(TO_XYZ).T, 0, 1)


def features(linear: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Strengths of edges and points (FLIP, Sec. 4.2): first and second derivatives of a Gaussian of 0.082 degrees."""
    deviation = 0.5 * 0.082 * PPD
    steps = np.arange(-math.ceil(3 * deviation), math.ceil(3 * deviation) + 1)
    gauss = np.exp(-(steps**2) / (2 * deviation**2))
    grey = (opponent(linear)[..., 0] + 16) / 116
    strengths = []
    for derivative in (-steps * gauss, (steps**2 / deviation**2 - 1) * gauss):
        kernel = np.outer(gauss, derivative)
        kernel = np.where(kernel > 0, kernel / kernel[kernel > 0].sum(), kernel / -kernel[kernel < 0].sum())
        strengths.append(np.hypot(*(convolve(grey, k, mode="nearest") for k in (kernel, kernel.T))))
    return strengths[0], strengths[1]


def reference(prediction: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """The FLIP map of two linear pictures in [0, 1], float64."""
    most = hyab(*(hunt_lab(np.array(primary)) for primary in ([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]))) ** 0.7
    colour = hyab(hunt_lab(filtered(prediction)), hunt_lab(filtered(truth))) ** 0.7
    bend = 0.4 * most
    colour = np.where(colour < bend, 0.95 / bend * colour, 0.95 + (colour - bend) / (most - bend) * 0.05)
    edges, points = (np.abs(a - b) for a, b in zip(features(prediction), features(truth), strict=True))
    return colour ** (1 - np.sqrt(np.maximum(edges, points) / math.sqrt(2)))


def test_flip_is_the_papers() -> None:
    p = pair()
    expected = reference(np.clip(p.prediction, 0, 1), p.truth)
    full, mask = (metric(f"flip:region={region}")([p])[0].value for region in ("full", "mask"))
    assert full == pytest.approx(expected.mean(), abs=2e-5)
    assert mask == pytest.approx(expected[p.mask > 0.5].mean(), abs=2e-5)


@pytest.mark.parametrize("name", ["flip", "hdr-flip"])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_cut_does_not_show(name: str, seed: int) -> None:
    """In a region the value is the mean of the whole picture's map there, as the evaluator draws it."""
    p = pair(seed, bright=6.0)
    parameters = {"ppd": PPD}
    if name == "flip":
        images = [srgb(image).astype(np.float32) for image in (p.truth, p.prediction)]
        errors = flip_evaluator.evaluate(*images, "LDR", applyMagma=False, parameters=parameters)[0]
    else:
        parameters |= {"startExposure": -4.0, "stopExposure": 2.0, "numExposures": 4, "tonemapper": "aces"}
        images = [image.astype(np.float32) for image in (p.truth, p.prediction)]
        errors = flip_evaluator.evaluate(*images, "HDR", applyMagma=False, parameters=parameters)[0]
    errors = errors.reshape(p.mask.shape)
    box = np.s_[6:38, 0:30]
    assert metric(name)([p])[0].value == pytest.approx(errors[p.mask > 0.5].mean(), abs=1e-6)
    assert metric(f"{name}:region=box")([p])[0].value == pytest.approx(errors[box].mean(), abs=1e-6)


def test_hdr_flip_is_the_greatest_flip_of_tone_mapped_exposures() -> None:
    """HDR-FLIP paper, Sec. 4, with the ACES curve that its code uses."""
    p = pair(3, bright=8.0)

    def shown(linear: np.ndarray, exposure: float) -> np.ndarray:
        x = 0.6 * linear * 2.0**exposure
        return np.clip((x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)

    maps = [reference(shown(p.prediction, stop), shown(p.truth, stop)) for stop in (-4, -2, 0, 2)]
    expected = np.max(maps, axis=0)
    assert metric("hdr-flip:region=full")([p])[0].value == pytest.approx(expected.mean(), abs=5e-5)
    assert expected.mean() > max(m.mean() for m in maps) + 1e-3


def test_the_signature_says_how_it_is_looked_at() -> None:
    assert metric("flip").signature == "flip|region:mask|space:srgb|scale:none|mask:alpha>0.5|ppd:67.02|v1"
    assert metric("hdr-flip").signature == (
        "hdr-flip|region:mask|space:linear|scale:none|mask:alpha>0.5|ppd:67.02|exposures:-4..2/4|tone:aces|clip:0..65504|v1"
    )


def test_the_evaluators_defaults_are_meant() -> None:
    """Without parameters it takes the same pixels per degree."""
    p = pair(4)
    images = [srgb(image).astype(np.float32) for image in (p.truth, p.prediction)]
    _, mean, _ = flip_evaluator.evaluate(*images, "LDR", applyMagma=False)
    assert metric("flip:region=full")([p])[0].value == pytest.approx(mean, abs=1e-6)


def test_any_prediction_has_a_value() -> None:
    p = pair(5)
    for prediction in (-p.truth, np.full_like(p.truth, 1e30), np.zeros_like(p.truth)):
        for name in ("flip", "hdr-flip"):
            value = metric(name)([Pair(prediction, p.truth, p.mask)])[0].value
            assert value is not None and 0.05 < value <= 1.0
