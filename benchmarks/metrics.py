"""Scoring pictures: PSNR, SSIM and LPIPS-Alex against one call of scikit-image and a plain torch LPIPS a picture.

The reference is given pictures as displayed, for nothing; handbench starts from linear ones. Both do
the same twice: over the whole picture, where every value must agree to 1e-5, and as a protocol has it (PSNR and SSIM in
the mask, LPIPS in the hand's box), where handbench leaves out what does not count. All truths differ, so no features
are remembered; then the same truths are scored again, as for a run's second method.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from skimage.transform import resize
from torch import Tensor
from torch.nn.functional import conv2d, max_pool2d

from handbench.metrics import Looks, Metric, Pair, metric, scores
from handbench.metrics.networks import SCALE, SHIFT, STAGES, network_weights
from handbench.registry import CAPTURES
from handbench.scene.colour import srgb
from handbench.tuning import tune

from .measure import Measurement, summary

HEIGHT, WIDTH = 512, 334  # of InterHand2.6M
COUNT, CHUNK = 200, 8
WHOLE = tuple(f"{name}:region=full" for name in ("psnr", "ssim", "lpips-alex"))
USUAL = ("psnr", "ssim", "lpips-alex")

Picture = NDArray[np.float64]


def scoring() -> list[Measurement]:
    """Milliseconds a picture, handbench's share of the reference's time, and the greatest difference of a value.

    How much the box saves depends on how much of the picture it is: measured with frames that fill the picture as
    those of the capture do, and with frames of three quarters of its height.
    """
    tune()  # as a run does
    return [*_scoring("close", 1.0), *_scoring("farther", 0.75)]


def _scoring(framing: str, size: float) -> list[Measurement]:
    reference, times = ReferenceMetrics(), _Times()
    metrics = {"whole": [metric(spec) for spec in WHOLE], "usual": [metric(spec) for spec in USUAL]}
    first = next(_chunks(size))[0]
    scores(metrics["usual"], [Pair(first.truth, first.prediction, first.mask)])  # reads the weights, knows no truth
    off, boxes = 0.0, []
    for pairs in _chunks(size):
        shown = [(srgb(pair.prediction.astype(np.float64)), srgb(pair.truth.astype(np.float64))) for pair in pairs]
        expected = times.timed("reference", partial(_expected, reference, shown))
        rows = times.timed("whole", partial(_values, metrics["whole"], pairs))
        times.timed("usual", partial(_values, metrics["usual"], pairs))
        times.timed("usual again", partial(_values, metrics["usual"], pairs))
        off = max(off, float(np.abs(np.array(expected) - np.array(rows)).max()))
        boxes += [Looks(pair).view(metrics["usual"][-1].options).support.size / pair.mask.size for pair in pairs]
    what = f"scoring {COUNT} pictures, {framing}"
    return [
        summary(f"{what}: the hand's box, share of the picture", "", boxes),
        summary(f"{what}: reference, each", "ms", times.each("reference")),
        summary(f"{what}: whole picture, share of the reference's time", "", times.share("whole")),
        summary(f"{what}: whole picture, greatest difference", "", [off], 1e-5),
        summary(f"{what}: mask and box, each", "ms", times.each("usual")),
        summary(f"{what}: mask and box, share of the reference's time", "", times.share("usual"), 1 / 3),
        summary(f"{what}: mask and box, truths known, share", "", times.share("usual again")),
    ]


class _Times:
    """Seconds of each chunk by what was done."""

    def __init__(self) -> None:
        self._seconds: dict[str, list[float]] = {}

    def timed(self, what: str, work: Callable[[], list[list[float]]]) -> list[list[float]]:
        start = time.perf_counter()
        done = work()
        self._seconds.setdefault(what, []).append(time.perf_counter() - start)
        return done

    def each(self, what: str) -> list[float]:
        return [1000 * spent / CHUNK for spent in self._seconds[what]]

    def share(self, what: str) -> list[float]:
        return [a / b for a, b in zip(self._seconds[what], self._seconds["reference"], strict=True)]


class ReferenceMetrics:
    """PSNR and SSIM by scikit-image in float64, LPIPS-Alex by plain torch in float32 and its usual memory order."""

    def __init__(self) -> None:
        self.weights = {name: value.contiguous() for name, value in network_weights("lpips_alex").items()}

    def scores(self, prediction: Picture, truth: Picture) -> list[float]:
        psnr = peak_signal_noise_ratio(truth, prediction, data_range=1)
        ssim = structural_similarity(
            prediction, truth, gaussian_weights=True, use_sample_covariance=False, channel_axis=-1, data_range=1
        )
        return [float(psnr), float(ssim), self.lpips(prediction, truth)]

    @torch.no_grad()
    def lpips(self, prediction: Picture, truth: Picture) -> float:
        total = 0.0
        pairs = zip(self._features(prediction), self._features(truth), strict=True)
        for layer, (a, b) in enumerate(pairs):
            a, b = (f / (f.square().sum(1, keepdim=True).sqrt() + 1e-10) for f in (a, b))
            total += conv2d((a - b) ** 2, self.weights[f"head{layer}.weight"].view(1, -1, 1, 1)).mean().item()
        return total

    def _features(self, image: Picture) -> Iterator[Tensor]:
        x = torch.from_numpy(image.astype(np.float32)).permute(2, 0, 1)[None].contiguous()
        shift, scale = (torch.tensor(v).view(1, 3, 1, 1) for v in (SHIFT, SCALE))
        x = (2 * x - 1 - shift) / scale
        for layer, stage in enumerate(STAGES["alex"]):
            if stage.pool != (1, 1):
                x = max_pool2d(x, *stage.pool)
            for stride, padding in stage.convolutions:
                x = conv2d(
                    x, self.weights[f"conv{layer}.weight"], self.weights[f"conv{layer}.bias"], stride, padding
                ).relu()
            yield x


def _expected(reference: ReferenceMetrics, shown: Sequence[tuple[Picture, Picture]]) -> list[list[float]]:
    return [reference.scores(*images) for images in shown]


def _values(metrics: Sequence[Metric], pairs: Sequence[Pair]) -> list[list[float]]:
    return [[score.value if score.value is not None else np.nan for score in row] for row in scores(metrics, pairs)]


def _chunks(size: float) -> Iterator[list[Pair]]:
    """COUNT pairs, CHUNK at a time: frames of `mini` enlarged, each in a light of its own, and noisy predictions."""
    capture = CAPTURES.load("openstage")("mini")
    frames = [capture.observe(frame) for frame in capture.frames()]
    rng = np.random.default_rng(0)
    height, width = int(size * HEIGHT), int(size * WIDTH)
    margin = [((HEIGHT - height) // 2, (HEIGHT - height + 1) // 2), ((WIDTH - width) // 2, (WIDTH - width + 1) // 2)]
    for first in range(0, COUNT, CHUNK):
        pairs = []
        for index in range(first, first + CHUNK):
            seen = frames[index % len(frames)]
            image, alpha = (
                np.pad(resize(np.asarray(a), (height, width, *a.shape[2:]), order=1), [*margin, (0, 0)][: a.ndim])
                for a in (seen.image, seen.alpha)
            )
            truth = (image * rng.uniform(0.7, 1.3, 3)).astype(np.float32)
            noise = rng.standard_normal(truth.shape).astype(np.float32)
            pairs.append(Pair(np.abs(truth * (0.9 + 0.1 * noise)), truth, alpha))
        yield pairs
