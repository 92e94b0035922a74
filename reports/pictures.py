"""Pictures as files: small ones embedded in the page, and grids that a paper can take, as PNG and PDF."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
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

from handbench.errors import InputError
from handbench.results.record import MetricRecord
from handbench.scene import Array
from handbench.scene.colour import srgb

from .figures import ERROR_SCALE, Panel, Tile, detail
from .frames import KINDS
from .printed import letter, number

COLOURS = colormaps["inferno"]
EMBEDDED = 256  # pixels, the greatest side of an embedded picture
DPI = 160
_LARGEST = 1 << 27  # pixels of a figure: 512 MiB while it is drawn
KNEE, STOPS = 0.8, 4.0  # of `beyond_white`
STYLE: Any = {"font.size": 7.5, "font.family": "DejaVu Sans", "pdf.fonttype": 42}
MARKED = "#39d0ff"  # the frame of a detail: no colour of a hand or of the error map
_TILE, _GAP, _LINE, _FOOT = 1.3, 0.05, 0.17, 0.55  # inches: a tile, between tiles, a line of text, the colour bar
_LEAST, _MOST = 0.62, 8  # inches of the smallest tile, and tiles in a line of a grid of no given width


def webp(image: Array, side: int = EMBEDDED) -> str:
    """An sRGB image (H, W, 3) in [0, 1] as the base64 text of a WebP no larger than `side`.

    At this quality half the error of a JPEG of the same size: 0.0015 on average, 0.013 in the worst pixels.
    """
    picture = Image.fromarray(np.round(image * 255).astype(np.uint8))
    picture.thumbnail((side, side), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    picture.save(out, "WEBP", quality=98, method=0)  # slower methods save 5 % of the bytes
    return base64.b64encode(out.getvalue()).decode()


def beyond_white(linear: Array) -> Array:
    """An exposed linear picture in [0, 1] with room above white, for a viewer that can change the exposure.

    The sRGB curve up to `KNEE`, for white, then `STOPS` more in equal steps of the logarithm; what is brighter is cut.
    """
    linear = np.maximum(linear, 0.0)
    bright = KNEE + (1 - KNEE) * np.log2(np.maximum(linear, 1.0)) / STOPS
    return np.asarray(np.where(linear <= 1.0, KNEE * srgb(linear), np.minimum(bright, 1.0)))


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


def svg_uri(content: bytes) -> str:
    """An SVG file as a data address."""
    return "data:image/svg+xml;base64," + base64.b64encode(content).decode()


def palette() -> Array:
    """The colours of an error map, (256, 3) bytes."""
    return (COLOURS(np.arange(256))[:, :3] * 255).astype(np.uint8)


def colour_stops() -> str:
    """The colour map as the stops of a CSS gradient."""
    return ", ".join(f"rgb({r:.0f} {g:.0f} {b:.0f})" for r, g, b in COLOURS(np.linspace(0, 1, 9))[:, :3] * 255)


def saved(figure: Figure, dpi: int = DPI) -> dict[str, bytes]:
    """A figure by kind of file, "png" and "pdf": no dates, so the same figure gives the same bytes.

    In the PDF pictures keep their own pixels, and text is text. Raises `InputError` for more than `_LARGEST` pixels.
    """
    across, down = (round(inches * dpi) for inches in figure.get_size_inches())
    if across * down > _LARGEST:
        raise InputError(
            f"a figure of {across:,}x{down:,} pixels is too large to draw; give a smaller --dpi or --width"
        )
    FigureCanvasAgg(figure)
    found = {}
    for kind, undated in (("png", {"Software": None}), ("pdf", {"CreationDate": None})):
        out = io.BytesIO()
        for picture in (image for axes in figure.axes for image in axes.images):
            picture.set_interpolation("none" if kind == "pdf" else "antialiased")
        with rc_context(STYLE):
            figure.savefig(out, format=kind, dpi=dpi, metadata=undated)
        found[kind] = out.getvalue()
    return found


@dataclass(frozen=True)
class Sheet:
    """How large a grid of pictures is.

    width       inches; None: as wide as its tiles ask for
    dpi         of the PNG; None: as reports have it
    detail      whether each picture has its detail below it
    """

    width: float | None = None
    dpi: int | None = None
    detail: bool = True


@dataclass(frozen=True)
class _Grid:
    """The measures of a grid in inches: a tile's width, tiles in a line, the size of letters in points."""

    tile: float
    line: int
    size: float
    detail: bool

    @staticmethod
    def of(count: int, sheet: Sheet) -> _Grid:
        """The grid of `count` pictures beside each other; those that would be smaller than a thumb go below."""
        if sheet.width is None:
            line = min(count, _MOST)
            return _Grid(_TILE, line, STYLE["font.size"], sheet.detail)
        line = max(1, min(count, int((sheet.width - _GAP) / (_LEAST + _GAP))))
        tile = min(2 * _TILE, (sheet.width - _GAP) / line - _GAP)
        return _Grid(tile, line, float(np.clip(STYLE["font.size"] * tile / _TILE, 5.0, 9.0)), sheet.detail)

    @property
    def width(self) -> float:
        return self.line * (self.tile + _GAP) + _GAP

    def strips(self, panel: Panel) -> list[list[Tile]]:
        """The truth and the tiles of a panel, line by line."""
        tiles = [Tile("Truth", None, panel.truth, None), *panel.tiles]
        return [tiles[start : start + self.line] for start in range(0, len(tiles), self.line)]

    def height(self, panel: Panel) -> float:
        """Of one line of a panel: titles, pictures, details, error maps, scores."""
        tall, wide = panel.truth.shape[:2]
        return self.tile * (2 * tall / wide + self.detail) + 2 * _GAP + 2.4 * _LINE


def grid(panels: Sequence[Panel], metric: MetricRecord, sheet: Sheet = Sheet()) -> dict[str, bytes]:
    """Frames, each with its letter: a line of images, one of a detail, and one of error maps with their scores.

    More methods than fit the width go on below.
    """
    layout = _Grid.of(1 + max(len(panel.tiles) for panel in panels), sheet)
    kinds = dict.fromkeys(KINDS[panel.kind] for panel in panels)
    width = layout.width
    height = 2 * _LINE + sum(len(layout.strips(panel)) * layout.height(panel) for panel in panels) + _FOOT
    with rc_context({**STYLE, "font.size": layout.size}):
        figure = Figure(figsize=(width, height))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        axes.set(xlim=(0, width), ylim=(height, 0))
        _write(axes, width / 2, _LINE, "; ".join(kinds), size=min(9.0, 1.2 * layout.size))
        top = 2 * _LINE
        for index, panel in enumerate(panels, start=1):
            for tiles in layout.strips(panel):
                _strip(axes, panel, tiles, layout, metric, top)
                if tiles[0].title == "Truth":
                    axes.text(_GAP, top + 0.7 * _LINE, f"({letter(index)})", size=layout.size, weight="bold")
                top += layout.height(panel)
        bar = figure.colorbar(
            ScalarMappable(Normalize(0, ERROR_SCALE), COLOURS),
            cax=figure.add_axes((0.5 - 0.9 / width, (_FOOT - 0.16) / height, 1.8 / width, 0.08 / height)),
            orientation="horizontal",
            extend="max",
        )
        bar.set_label("mean absolute error of sRGB values", fontsize=7, labelpad=1)
        bar.ax.tick_params(labelsize=7, pad=1.5, length=2)
    return saved(figure, sheet.dpi or DPI)


def _strip(axes: Axes, panel: Panel, tiles: Sequence[Tile], layout: _Grid, metric: MetricRecord, top: float) -> None:
    tall, wide = panel.truth.shape[:2]
    across, size = layout.tile, layout.size
    side = across * tall / wide
    rows, columns = detail(panel)
    lines = [top + _LINE, top + _LINE + side + _GAP]
    lines.append(lines[1] + (across + _GAP) * layout.detail)
    for index, tile in enumerate(tiles):
        left = _GAP + index * (across + _GAP)
        middle = left + across / 2
        _write(axes, middle, top + 0.7 * _LINE, tile.title, size)
        if tile.image is None:
            _write(axes, middle, lines[0] + side / 2, "no image", size, colour="#6a665f")
            continue
        _show(axes, tile.image, (left, lines[0], across, side))
        if layout.detail:
            _show(axes, tile.image[rows, columns], (left, lines[1], across, across))
            _mark(axes, left, lines[1], across, across)
            pixel = across / wide
            box = (columns.stop - columns.start) * pixel
            _mark(axes, left + columns.start * pixel, lines[0] + rows.start * pixel, box, box)
        if tile.error is not None:
            error = COLOURS(np.clip(tile.error / ERROR_SCALE, 0, 1))[..., :3]
            _show(axes, error, (left, lines[2], across, side))
            score = f"{number(tile.score, metric.decimals)} {metric.unit}".strip()
            _write(axes, middle, lines[2] + side + 0.7 * _LINE, score, size)
        else:
            for line, part in enumerate(panel.query.split("/")):
                _write(axes, middle, lines[2] + side / 2 + (line - 1.5) * _LINE, part, size)


def _show(axes: Axes, image: Array, place: tuple[float, float, float, float]) -> None:
    """Draw an image at left, top, width and height."""
    left, top, width, height = place
    axes.imshow(image, extent=(left, left + width, top + height, top), aspect="auto")


def _mark(axes: Axes, left: float, top: float, width: float, height: float) -> None:
    axes.add_patch(Rectangle((left, top), width, height, fill=False, edgecolor=MARKED, linewidth=0.8))


def _write(axes: Axes, middle: float, base: float, text: str, size: float = 7.5, colour: str = "black") -> None:
    axes.text(middle, base, text, size=size, color=colour, ha="center", va="baseline", parse_math=False)
