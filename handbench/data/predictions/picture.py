"""One picture of a prediction folder."""

from __future__ import annotations

import io
from collections.abc import Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...scene import Array, Camera, Prediction
from ..exr import quiet_stderr, stack

_COLOUR = ("R", "G", "B", "A")
_DEPTH, _NORMAL = ("depth.Z",), ("normal.X", "normal.Y", "normal.Z")
_ALLOWED = [{*_COLOUR, *extra} for extra in ((), _DEPTH, _NORMAL, (*_DEPTH, *_NORMAL))]
_REC709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)


class Misfit(InputError):
    """What is wrong with a picture; `kind` is one of `problems.KINDS`."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


def read_picture(path: Path, camera: Camera) -> Prediction:
    """The prediction in an EXR file. Raises `Misfit` for the first thing that is wrong; NaN is passed on.

    The size is looked at before any pixel is read, so that no file makes us hold more than a camera's picture.
    """
    if not path.is_file():
        raise Misfit("unreadable", "is no file")
    parts, header, _ = _open(path, header_only=True)
    if parts != 1:
        raise Misfit("unreadable", f"has {parts} parts, expected 1")
    (left, top), (right, bottom) = (np.asarray(corner).tolist() for corner in header["dataWindow"])
    if (left, top, right, bottom) != (0, 0, camera.width - 1, camera.height - 1):
        at = f" at ({left}, {top})" if (left, top) != (0, 0) else ""
        size = f"{right - left + 1}x{bottom - top + 1}{at}"
        raise Misfit("size", f"is {size}, its camera says {camera.width}x{camera.height}")
    stated = header.get("chromaticities")
    if stated is not None and not np.allclose(np.ravel(stated), _REC709, atol=2e-3):
        raise Misfit("colour", f"states the chromaticities {np.round(np.ravel(stated), 4).tolist()}")
    channels = _open(path)[2]
    if set(channels) not in _ALLOWED:
        raise Misfit("channels", f"has {', '.join(sorted(channels)) or 'none'}")
    for name, pixels in channels.items():
        if pixels.dtype not in (np.float16, np.float32):
            raise Misfit("channels", f"has {name} as {pixels.dtype}")
        if pixels.shape != (camera.height, camera.width):
            raise Misfit("channels", f"has {name} as {pixels.shape}, subsampled")
    alpha = channels["A"].astype(np.float32)
    if (alpha < 0).any() or (alpha > 1).any():
        raise Misfit("colour", f"has alpha from {np.nanmin(alpha):.4g} to {np.nanmax(alpha):.4g}")
    depth = channels[_DEPTH[0]].astype(np.float32) if _DEPTH[0] in channels else None
    normal = _stacked(channels, _NORMAL, path) if _NORMAL[0] in channels else None
    return Prediction(_stacked(channels, _COLOUR[:3], path), alpha, depth=depth, normal=normal)


def not_finite(prediction: Prediction) -> int:
    """How many values of the image, alpha and maps are NaN or infinite."""
    given = (prediction.image, prediction.alpha, prediction.depth, prediction.normal)
    return sum(int(np.count_nonzero(~np.isfinite(np.asarray(values)))) for values in given if values is not None)


def _stacked(channels: Mapping[str, Array], names: tuple[str, ...], path: Path) -> Array:
    return stack(channels, names, path).astype(np.float32)


def _open(path: Path, header_only: bool = False) -> tuple[int, dict[str, Any], dict[str, Array]]:
    """Number of parts, header, and pixels by channel."""
    import OpenEXR

    try:
        with (
            redirect_stdout(io.StringIO()),  # for damaged files the binding prints, and raises as well
            quiet_stderr(),
            OpenEXR.File(str(path), separate_channels=True, header_only=header_only) as file,
        ):
            pixels = {} if header_only else {name: channel.pixels for name, channel in file.channels().items()}
            return len(file.parts), dict(file.header()), pixels
    except Exception as error:  # the binding raises plain RuntimeError, TypeError and others for damaged files
        text = " ".join(str(error).replace(str(path), "").split())
        raise Misfit("unreadable", f"cannot be read ({text[:120]})") from error
