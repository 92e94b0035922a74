"""Pictures as files: small ones embedded in the page, and grids that a paper can take, as PNG and PDF."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from PIL import Image

from handbench.scene import Array

from .figures import ERROR_SCALE, Panel, Tile, detail
from .frames import KINDS
from .model import Metric, number

COLOURS = colormaps["inferno"]
EMBEDDED = 256  # pixels, the greatest side of an embedded picture
DPI = 160
STYLE: Any = {"font.size": 7.5, "font.family": "DejaVu Sans", "pdf.fonttype": 42}
MARKED = "#39d0ff"  # the frame of a detail: no colour of a hand or of the error map
_TILE, _GAP, _LINE, _FOOT = 1.3, 0.05, 0.17, 0.55  # inches: a tile, between tiles, a line of text, the colour bar


def webp(image: Array, side: int = EMBEDDED) -> str:
    """An sRGB image (H, W, 3) in [0, 1] as the base64 text of a WebP no larger than `side`.

    At this quality half the error of a JPEG of the same size: 0.0015 on average, 0.013 in the worst pixels.
    """
    picture = Image.fromarray(np.round(image * 255).astype(np.uint8))
    picture.thumbnail((side, side), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    picture.save(out, "WEBP", quality=98, method=0)  # slower methods save 5 % of the bytes
    return base64.b64encode(out.getvalue()).decode()


def image_uri(image: Array) -> str:
    """An sRGB image (H, W, 3) in [0, 1] as a WebP data address."""
    return "data:image/webp;base64," + webp(image)


def error_uri(error: Array) -> str:
    """An error map (H, W) as a PNG data address, coloured from 0 to `ERROR_SCALE`."""
    levels = np.round(np.clip(error / ERROR_SCALE, 0, 1) * 255).astype(np.uint8)
    picture = Image.fromarray(levels)
    picture.thumbnail((EMBEDDED, EMBEDDED), Image.Resampling.BOX)
    picture.putpalette(palette().tobytes())
    out = io.BytesIO()
    picture.save(out, "PNG", optimize=True)
    return png_uri(out.getvalue())


def png_uri(content: bytes) -> str:
    """A PNG file as a data address."""
    return "data:image/png;base64," + base64.b64encode(content).decode()


def palette() -> Array:
    """The colours of an error map, (256, 3) bytes."""
    return (COLOURS(np.arange(256))[:, :3] * 255).astype(np.uint8)


def colour_stops() -> str:
    """The colour map as the stops of a CSS gradient."""
    return ", ".join(f"rgb({r:.0f} {g:.0f} {b:.0f})" for r, g, b in COLOURS(np.linspace(0, 1, 9))[:, :3] * 255)


def saved(figure: Figure) -> dict[str, bytes]:
    """A figure by kind of file, "png" and "pdf": no dates, so the same figure gives the same bytes.

    In the PDF pictures keep their own pixels, and text is text.
    """
    FigureCanvasAgg(figure)
    found = {}
    for kind, undated in (("png", {"Software": None}), ("pdf", {"CreationDate": None})):
        out = io.BytesIO()
        for picture in (image for axes in figure.axes for image in axes.images):
            picture.set_interpolation("none" if kind == "pdf" else "antialiased")
        with rc_context(STYLE):
            figure.savefig(out, format=kind, dpi=DPI, metadata=undated)
        found[kind] = out.getvalue()
    return found


def grid(panels: Sequence[Panel], metric: Metric) -> dict[str, bytes]:
    """The panels of one kind of light: for each frame a line of images, one of a detail and one of error maps."""
    columns = 1 + len(panels[0].tiles)
    width = columns * (_TILE + _GAP) + _GAP
    height = 2 * _LINE + sum(_height(panel) for panel in panels) + _FOOT
    with rc_context(STYLE):
        figure = Figure(figsize=(width, height))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        axes.set(xlim=(0, width), ylim=(height, 0))
        _write(axes, width / 2, _LINE, KINDS[panels[0].kind], size=9)
        top = 2 * _LINE
        for panel in panels:
            _panel(axes, panel, metric, top)
            top += _height(panel)
        bar = figure.colorbar(
            ScalarMappable(Normalize(0, ERROR_SCALE), COLOURS),
            cax=figure.add_axes((0.5 - 0.9 / width, (_FOOT - 0.16) / height, 1.8 / width, 0.08 / height)),
            orientation="horizontal",
            extend="max",
        )
        bar.set_label("mean absolute error of sRGB values", fontsize=7, labelpad=1)
        bar.ax.tick_params(labelsize=7, pad=1.5, length=2)
    return saved(figure)


def _height(panel: Panel) -> float:
    tall, wide = panel.truth.shape[:2]
    return _TILE * (2 * tall / wide + 1) + 2 * _GAP + 2.4 * _LINE


def _panel(axes: Axes, panel: Panel, metric: Metric, top: float) -> None:
    tall, wide = panel.truth.shape[:2]
    side = _TILE * tall / wide
    rows, columns = detail(panel)
    lines = (top + _LINE, top + _LINE + side + _GAP, top + _LINE + side + _TILE + 2 * _GAP)
    for index, tile in enumerate((Tile("truth", None, panel.truth, None), *panel.tiles)):
        left = _GAP + index * (_TILE + _GAP)
        middle = left + _TILE / 2
        _write(axes, middle, top + 0.7 * _LINE, tile.title)
        if tile.image is None:
            _write(axes, middle, lines[0] + side / 2, "no image", colour="#6a665f")
            continue
        _show(axes, tile.image, left, lines[0], side)
        _show(axes, tile.image[rows, columns], left, lines[1], _TILE)
        _mark(axes, left, lines[1], _TILE, _TILE)
        pixel = _TILE / wide
        box = (columns.stop - columns.start) * pixel
        _mark(axes, left + columns.start * pixel, lines[0] + rows.start * pixel, box, box)
        if tile.error is not None:
            _show(axes, COLOURS(np.clip(tile.error / ERROR_SCALE, 0, 1))[..., :3], left, lines[2], side)
            score = f"{number(tile.score, metric.decimals)} {metric.unit}".strip()
            _write(axes, middle, lines[2] + side + 0.7 * _LINE, score)
    for line, part in enumerate(panel.query.split("/")):
        _write(axes, _GAP + _TILE / 2, lines[2] + side / 2 + (line - 1.5) * _LINE, part)


def _show(axes: Axes, image: Array, left: float, top: float, height: float) -> None:
    axes.imshow(image, extent=(left, left + _TILE, top + height, top), aspect="auto")


def _mark(axes: Axes, left: float, top: float, width: float, height: float) -> None:
    axes.add_patch(Rectangle((left, top), width, height, fill=False, edgecolor=MARKED, linewidth=0.8))


def _write(axes: Axes, middle: float, base: float, text: str, size: float = 7.5, colour: str = "black") -> None:
    axes.text(middle, base, text, size=size, color=colour, ha="center", va="baseline", parse_math=False)
