"""What an OpenEXR file says of itself before a pixel is read: parts, channels, windows, primaries."""

from __future__ import annotations

import io
import os
import threading
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from .filekind import MAX_PIXELS, check_kind, check_size

_SAMPLES = 4  # channels of a picture of the greatest size: the library reads all channels of all parts

_REC709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
_PRIMARIES = {
    "ACES (AP0)": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767),
    "ACEScg (AP1)": (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767),
    "Rec. 2020": (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329),
    "P3-D65": (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329),
}
_TOLERANCE = 2e-3  # of xy: what is written with three digits is the same


@dataclass(frozen=True)
class Window:
    """Pixels from (left, top) to (right, bottom), both counted."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def width(self) -> int:
        return self.right - self.left + 1

    @property
    def height(self) -> int:
        return self.bottom - self.top + 1

    def __str__(self) -> str:
        return f"{self.width}x{self.height} at ({self.left}, {self.top})"


@dataclass(frozen=True)
class ExrPart:
    """One part of a file: channels with their sampling (x, y), the window stored and the one shown, what colours are.

    `colours` names primaries that are stated and are not those of Rec. 709; None if they are, or are not stated.
    `cube` tells that the file says it is a cube map.
    """

    index: int
    name: str
    channels: Mapping[str, tuple[int, int]]
    data: Window
    display: Window
    colours: str | None
    cube: bool


def read_parts(path: Path, what: str = "image", max_pixels: int = MAX_PIXELS) -> tuple[ExrPart, ...]:
    """The parts of an EXR file by its header. `what` is what messages call the file.

    Raises `InputError` for a file that is missing, of another kind, damaged, deep, or larger than `max_pixels`
    pixels of four channels: before memory is taken for them.
    """
    check_kind(path, what)
    with opened(path, what, header_only=True) as file:
        parts = tuple(_part(i, part.header, path, what) for i, part in enumerate(file.parts))
    total = 0
    for part in parts:
        for window in (part.data, part.display):
            check_size(path, what, window.width, window.height, max_pixels)
        total += part.data.width * part.data.height * len(part.channels)
    if total > _SAMPLES * max_pixels:
        raise InputError(
            f"{what} {path} holds {total} values in all its channels, more than {_SAMPLES * max_pixels}; leave out "
            "channels that are not needed, or raise the limit (--max-pixels)"
        )
    return parts


def the_part(parts: tuple[ExrPart, ...], name: str | None, path: Path, what: str = "image") -> ExrPart:
    """The part of that name or number (from 0), or the only one.

    Raises `InputError` for a name that is none, or for several parts of which none is said.
    """
    known = " and ".join(repr(part.name or str(part.index)) for part in parts)
    if name is None:
        if len(parts) > 1:
            raise InputError(f"{what} {path} has the parts {known}; say which one counts (--part)")
        return parts[0]
    for part in parts:
        if name in (part.name, str(part.index)):
            return part
    raise InputError(f"{what} {path} has no part {name!r}; it has {known if any(p.name for p in parts) else 'one'}")


def colour_channels(part: ExrPart, layer: str | None, path: Path, what: str = "image") -> tuple[str, ...]:
    """The channels red, green, blue, and alpha if there is one, of a layer or (None) of no layer.

    Upper case goes before lower case. Raises `InputError` if there are none, with the layers that have some.
    """
    found = _colours_in(part.channels, layer)
    if found:
        return found
    layers = {name.rpartition(".")[0] for name in part.channels if "." in name}
    known = ", ".join(repr(layer) for layer in sorted(layers) if _colours_in(part.channels, layer))
    text = f"{what} {path} has no channels R, G, B{f' in a layer {layer!r}' if layer else ''}"
    if known:
        raise InputError(f"{text}, but the layers {known}; say which one counts (--layer)")
    names = sorted(part.channels)
    raise InputError(f"{text}; it has {', '.join(names[:8]) or 'none'}{', …' if len(names) > 8 else ''}")


def _colours_in(names: Collection[str], layer: str | None) -> tuple[str, ...]:
    prefix = f"{layer}." if layer else ""
    for letters in ("RGBA", "rgba"):
        *colours, alpha = (prefix + letter for letter in letters)
        if all(name in names for name in colours):
            return (*colours, alpha) if alpha in names else tuple(colours)
    return ()


@contextmanager
def opened(path: Path, what: str = "image", header_only: bool = False) -> Iterator[Any]:
    """The binding's file, read without noise; `InputError` if it is damaged."""
    import OpenEXR

    try:
        with (
            quiet_stderr(),
            redirect_stdout(io.StringIO()),  # for damaged files the binding prints, and raises as well
            OpenEXR.File(str(path), separate_channels=True, header_only=header_only) as file,
        ):
            yield file
    except InputError:
        raise
    except Exception as error:  # the binding raises plain RuntimeError, TypeError and others for damaged files
        told = " ".join(str(error).replace(str(path), "").split())[:120]
        raise InputError(f"{what} {path} is damaged or no EXR file ({told}); write it anew") from error


_SILENCE = threading.Lock()


@contextmanager
def quiet_stderr() -> Iterator[None]:
    """Silence file descriptor 2: the C library prints a line for every damaged chunk, our error is enough.

    The descriptor is the process's, so threads come one by one.
    """
    with _SILENCE:
        saved, sink = os.dup(2), os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(sink, 2)
            yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            os.close(sink)


def _part(index: int, header: Mapping[str, Any], path: Path, what: str) -> ExrPart:
    import OpenEXR

    if header.get("type") in (OpenEXR.deepscanline, OpenEXR.deeptile):
        raise InputError(f"{what} {path} is a deep EXR, which is not supported; flatten it")
    channels = {channel.name: (channel.xSampling, channel.ySampling) for channel in header["channels"]}
    data, display = (_window(header[name]) for name in ("dataWindow", "displayWindow"))
    cube = header.get("envmap") == OpenEXR.ENVMAP_CUBE
    return ExrPart(index, str(header.get("name") or ""), channels, data, display, _colours(header), cube)


def _window(corners: Any) -> Window:
    (left, top), (right, bottom) = (np.asarray(corner).tolist() for corner in corners)
    return Window(left, top, right, bottom)


def _colours(header: Mapping[str, Any]) -> str | None:
    stated, named = header.get("chromaticities"), str(header.get("colorInteropID") or "")
    if stated is not None:
        values = np.ravel(stated)
        if np.allclose(values, _REC709, atol=_TOLERANCE):
            return None
        close = (name for name, xy in _PRIMARIES.items() if np.allclose(values, xy, atol=_TOLERANCE))
        return next(close, str(np.round(values, 4).tolist()))
    if header.get("acesImageContainerFlag") == 1:
        return "ACES (AP0)"
    if named and not named.startswith(("lin_rec709", "data", "unknown")):
        return repr(named)
    return None
