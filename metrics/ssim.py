"""Structural similarity (Wang et al., IEEE TIP 2004): Gaussian window of 11 pixels, sigma 1.5, by scikit-image.

The map is averaged over the region and the channels. The cut it is computed in reaches one window radius beyond the
region, so that the map inside equals that of the whole image. Over the full image it is scikit-image's own mean,
which leaves out a border of 5 pixels where the window sticks out.
"""

from __future__ import annotations

from skimage.metrics import structural_similarity

from .base import Family
from .view import View

WINDOW = 11


def ssim(view: View) -> float:
    """Mean SSIM, data range 1, in [-1, 1]. In float64: variances are small differences of squares."""
    mean, similarity = structural_similarity(
        view.prediction,
        view.truth,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        channel_axis=-1,
        data_range=1.0,
        full=True,
    )
    return float(mean if view.region == "full" else similarity[view.support].mean())


SSIM = Family(
    "ssim",
    "SSIM",
    ssim,
    higher_is_better=True,
    decimals=4,
    terms=(f"window:gauss{WINDOW}/1.5", "range:1"),
    context=WINDOW // 2,
    least=WINDOW,
)
