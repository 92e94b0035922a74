"""Panels as picture files: small ones embedded in the page, and grids that a paper can take."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from PIL import Image

from handbench.scene import Array

from .figures import ERROR_SCALE, KIND_TITLES, Panel
from .model import Metric, number

COLOURS = colormaps["inferno"]
EMBEDDED = 256  # pixels, the greatest side of an embedded picture
DPI = 160


def image_uri(image: Array) -> str:
    """An sRGB image (H, W, 3) in [0, 1] as a JPEG data address."""
    picture = Image.fromarray(np.round(image * 255).astype(np.uint8))
    picture.thumbnail((EMBEDDED, EMBEDDED), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    picture.save(out, "JPEG", quality=90, subsampling=0)
    return "data:image/jpeg;base64," + base64.b64encode(out.getvalue()).decode()


def error_uri(error: Array) -> str:
    """An error map (H, W) as a PNG data address, coloured from 0 to `ERROR_SCALE`."""
    levels = np.round(np.clip(error / ERROR_SCALE, 0, 1) * 255).astype(np.uint8)
    picture = Image.fromarray(levels)
    picture.thumbnail((EMBEDDED, EMBEDDED), Image.Resampling.BOX)
    picture.putpalette((COLOURS(np.arange(256))[:, :3] * 255).astype(np.uint8).tobytes())
    out = io.BytesIO()
    picture.save(out, "PNG", optimize=True)
    return png_uri(out.getvalue())


def png_uri(content: bytes) -> str:
    """A PNG file as a data address."""
    return "data:image/png;base64," + base64.b64encode(content).decode()


def colour_stops() -> str:
    """The colour map as the stops of a CSS gradient."""
    return ", ".join(f"rgb({r:.0f} {g:.0f} {b:.0f})" for r, g, b in COLOURS(np.linspace(0, 1, 9))[:, :3] * 255)


def grid_png(panels: Sequence[Panel], metric: Metric) -> bytes:
    """The panels of one kind of light: a line of images and a line of error maps for each frame."""
    columns = 1 + len(panels[0].tiles)
    layout = ConstrainedLayoutEngine(w_pad=0.015, h_pad=0.015, wspace=0.0, hspace=0.01)
    tall, wide = panels[0].truth.shape[:2]
    height = (2.7 * tall / wide + 0.25) * len(panels) + 0.7
    figure = Figure(figsize=(1.35 * columns, height), dpi=DPI, layout=layout)
    FigureCanvasAgg(figure)
    figure.suptitle(KIND_TITLES[panels[0].kind], fontsize=9)
    axes = figure.subplots(2 * len(panels), columns, squeeze=False)
    for line, panel in enumerate(panels):
        images, errors = axes[2 * line], axes[2 * line + 1]
        _show(images[0], panel.truth, "truth")
        errors[0].set_axis_off()
        errors[0].text(0.5, 0.5, panel.query.replace("/", "\n"), ha="center", va="center", fontsize=7)
        for tile, above, below in zip(panel.tiles, images[1:], errors[1:], strict=True):
            _show(above, tile.image, tile.title)
            if tile.error is None:
                below.set_axis_off()
            else:
                _show(below, COLOURS(np.clip(tile.error / ERROR_SCALE, 0, 1)))
                below.set_xlabel(f"{number(tile.score, metric.decimals)} {metric.unit}".strip(), fontsize=7, labelpad=2)
    bar = figure.colorbar(_scale(), ax=axes, orientation="horizontal", shrink=0.35, aspect=45, pad=0.01, extend="max")
    bar.set_label("mean absolute error of sRGB values", fontsize=7)
    bar.ax.tick_params(labelsize=7)
    out = io.BytesIO()
    figure.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()


def _show(axes: Axes, image: Array | None, title: str = "") -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    for side in axes.spines.values():
        side.set_visible(False)
    axes.set_title(title, fontsize=7.5, pad=2)
    if image is None:
        axes.text(0.5, 0.5, "no image", ha="center", va="center", fontsize=7, transform=axes.transAxes)
    else:
        axes.imshow(image, interpolation="antialiased")


def _scale() -> ScalarMappable:
    return ScalarMappable(Normalize(0, ERROR_SCALE), COLOURS)
