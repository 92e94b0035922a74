"""How good is a relit image: metrics with signatures. `ENTRIES` is the table the harness reads.

    metric("psnr")([Pair(prediction, truth, alpha), …]) -> [Score(31.2, None), …]
    metric("psnr:region=box,scale=rgb").signature

To add a metric, write one module with a `Family` and name it in `ENTRIES`.
"""

from handbench.registry import Entry

from .base import Family, Metric, Pair, Score, from_signature, metric
from .view import View, srgb

__all__ = ["ENTRIES", "Family", "Metric", "Pair", "Score", "View", "from_signature", "metric", "srgb"]

ENTRIES: tuple[Entry, ...] = (
    Entry("psnr", "handbench.metrics.psnr:PSNR", "peak signal-to-noise ratio of the hand's pixels"),
    Entry("ssim", "handbench.metrics.ssim:SSIM", "structural similarity (Gaussian window) of the hand's pixels"),
    Entry("lpips-alex", "handbench.metrics.lpips:ALEX", "learned perceptual distance, AlexNet features"),
    Entry("lpips-vgg", "handbench.metrics.lpips:VGG", "learned perceptual distance, VGG-16 features"),
)
