"""OpenEXR files: named channels in, named channels out, nothing half-written."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import whole
from ..scene import Array


def write_exr(path: Path, channels: Mapping[str, Array]) -> None:
    """Write float16 or float32 channels, each (H, W), under names such as "R" or "normal.X".

    The file appears whole or not at all. Raises `InputError` for a shape or type that EXR lacks and
    `StorageError` when the disk is full or the folder cannot be written.
    """
    import OpenEXR

    shapes = {np.shape(pixels) for pixels in channels.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise InputError(f"{path}: the channels of an EXR must share one (H, W) shape, got {sorted(shapes)}")
    for name, pixels in channels.items():
        if pixels.dtype not in (np.float16, np.float32):
            raise InputError(f"{path}: channel {name!r} is {pixels.dtype}, expected float16 or float32")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with whole(path) as part:
        try:
            OpenEXR.File(header, {name: np.ascontiguousarray(p) for name, p in channels.items()}).write(str(part))
        except RuntimeError as error:  # the library's only word for a full disk or a folder that is none
            raise OSError(str(error)) from error


def read_exr(path: Path) -> dict[str, Array]:
    """The channels of an EXR file by name, each (H, W) float32.

    Raises `InputError` for a file that is missing, is no EXR, is truncated or has NaN or infinite pixels.
    """
    import OpenEXR

    if not path.is_file():
        raise InputError(f"image {path} does not exist; generate the capture again or check its folder")
    try:
        with quiet_stderr(), OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels.astype(np.float32) for name, channel in file.channels().items()}
    except Exception as error:  # the binding raises plain RuntimeError, TypeError and others for damaged files
        raise InputError(
            f"image {path} is damaged or no EXR file ({error}); delete it and generate it again"
        ) from error
    for name, pixels in channels.items():
        if not np.isfinite(pixels).all():
            raise InputError(
                f"image {path}: channel {name!r} has NaN or infinite pixels; delete it and generate it again"
            )
    return channels


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


def rgb(image: Array, prefix: str = "", dtype: type = np.float16) -> dict[str, Array]:
    """The channels of an (H, W, 3) image, named R, G, B."""
    return {f"{prefix}{name}": image[..., i].astype(dtype) for i, name in enumerate("RGB")}


def stack(channels: Mapping[str, Array], names: tuple[str, ...], path: Path) -> Array:
    """Named channels as one (H, W, C) array; `InputError` if the file lacks one."""
    missing = [name for name in names if name not in channels]
    if missing:
        raise InputError(f"image {path} has no channel {missing[0]!r}; it has {', '.join(sorted(channels))}")
    return np.stack([channels[name] for name in names], axis=-1)
