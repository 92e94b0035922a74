"""How good is a relit image: metrics with signatures. `ENTRIES` is the table the harness reads.

    metric("psnr")([Pair(prediction, truth, alpha), …]) -> [Score(31.2, None), …]
    metric("psnr:region=box,scale=rgb").signature
    scores([metric("psnr"), metric("ssim")], pairs)       one row a pair; several metrics share what they look at

To add a metric, write one module with a `Family` (of pictures) or a `PairFamily` (of anything else in a pair) and
name it in `ENTRIES`.
"""

from handbench.registry import Entry

from .base import AnyFamily, Family, Metric, PairFamily, Score, from_signature, metric, scores
from .compat import ENTRIES as COMPATIBILITY
from .pair import Pair
from .view import Looks, Recent, View

__all__ = [
    "ENTRIES",
    "AnyFamily",
    "Family",
    "Looks",
    "Metric",
    "Pair",
    "PairFamily",
    "Recent",
    "Score",
    "View",
    "from_signature",
    "metric",
    "scores",
]

ENTRIES: tuple[Entry, ...] = (
    Entry("psnr", "handbench.metrics.psnr:PSNR", "peak signal-to-noise ratio of the hand's pixels"),
    Entry("ssim", "handbench.metrics.ssim:SSIM", "structural similarity (Gaussian window) of the hand's pixels"),
    Entry("ms-ssim", "handbench.metrics.msssim:MSSSIM", "structural similarity at five scales"),
    Entry("lpips-alex", "handbench.metrics.lpips:ALEX", "learned perceptual distance, AlexNet features"),
    Entry("lpips-vgg", "handbench.metrics.lpips:VGG", "learned perceptual distance, VGG-16 features"),
    Entry("dists", "handbench.metrics.dists:DISTS", "deep image structure and texture similarity, VGG-16 features"),
    Entry("flip", "handbench.metrics.flip:FLIP", "visible difference when flipping between the displayed pictures"),
    Entry("hdr-flip", "handbench.metrics.flip:HDR_FLIP", "the same over a fixed range of exposures"),
    Entry("depth", "handbench.metrics.geometry.maps:DEPTH", "mean error of the depth map"),
    Entry("normal", "handbench.metrics.geometry.maps:NORMAL", "mean angle between normal maps"),
    Entry("mask-iou", "handbench.metrics.geometry.maps:MASK", "overlap of the silhouettes"),
    Entry("surface-mean", "handbench.metrics.geometry.surface:MEAN", "mean distance of the true surface from the mesh"),
    Entry("surface-p95", "handbench.metrics.geometry.surface:P95", "95th percentile of that distance"),
    Entry("hausdorff", "handbench.metrics.geometry.surface:HAUSDORFF", "greatest distance of two surfaces"),
    Entry("chamfer", "handbench.metrics.geometry.surface:CHAMFER", "mean distance of two surfaces, both ways"),
    Entry("fscore", "handbench.metrics.geometry.surface:FSCORE", "share of two surfaces that is near (2, 1 or 5 mm)"),
    Entry("mesh-normal", "handbench.metrics.geometry.surface:NORMAL", "mean angle between the normals of two surfaces"),
    Entry("vertex", "handbench.metrics.geometry.points:VERTEX", "mean distance of the vertices of one topology"),
    Entry("joint", "handbench.metrics.geometry.points:JOINT", "mean distance of the joints, not aligned"),
    *COMPATIBILITY,
)
