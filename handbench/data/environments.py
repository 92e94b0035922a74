"""Files of environment maps, .exr, .hdr and .ktx, checked where they come in."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import InputError
from ..light.skybox import equirectangular
from ..scene import Array, Environment
from .exr import read_channels, stack
from .exrheader import colour_channels, read_parts, the_part
from .filekind import MAX_PIXELS
from .ktx import read_ktx
from .radiance import read_radiance

_WHAT = "environment map"
_GREATEST = 65504.0  # of half floats


def read_environment(
    path: Path,
    *,
    clip: bool = False,
    layer: str | None = None,
    part: str | None = None,
    max_pixels: int = MAX_PIXELS,
) -> Environment:
    """An equirectangular .exr, .hdr or .ktx file, or a cube map in a .ktx, as an environment named after the file.

    A cube map of n x n texels becomes a map of 2n x 4n; its faces are those that Filament's tools write.

    With `clip`, negative radiance becomes 0 (sharpening filters make some) and infinite radiance 65504, the greatest
    half float (a sun beyond it). `layer` and `part` choose within an EXR.
    Raises `InputError` for a file that is missing, damaged, of another kind, larger than `max_pixels`, cropped, a cube
    map, or of other colours than linear Rec. 709, and for NaN, infinite or negative radiance.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".exr":
        radiance = _read_exr(path, layer, part, max_pixels)
    elif suffix == ".ktx":
        faces = read_ktx(path, _WHAT, max_pixels)
        radiance = faces[0] if len(faces) == 1 else _unfolded(_checked(path, faces, clip))
    elif suffix in (".hdr", ".rgbe") or not path.exists():
        radiance = read_radiance(path, _WHAT, max_pixels)
    else:
        raise InputError(f"{_WHAT} {path} is none of .exr, .hdr and .ktx; convert it to one of them")
    height, width = radiance.shape[:2]
    if width != 2 * height:
        raise InputError(
            f"{_WHAT} {path} is {width}x{height}; an equirectangular map is twice as wide as high, convert it"
        )
    return Environment(path.stem, _checked(path, radiance, clip))


def _read_exr(path: Path, layer: str | None, part: str | None, max_pixels: int) -> Array:
    chosen = the_part(read_parts(path, _WHAT, max_pixels), part, path, _WHAT)
    if chosen.cube:
        raise InputError(f"{_WHAT} {path} says it is a cube map; convert it to equirectangular")
    if chosen.data != chosen.display:
        raise InputError(
            f"{_WHAT} {path} is cropped: it stores {chosen.data} of a picture of {chosen.display}; save all of it"
        )
    names = colour_channels(chosen, layer, path, _WHAT)[:3]
    return stack(read_channels(path, chosen, names, _WHAT, finite=False), names, path)


def _unfolded(faces: Array) -> Array:
    """The faces (6, n, n, 3) of a cube map as an equirectangular map."""
    size = 2 * faces.shape[1]
    return equirectangular(faces, size, 2 * size)


def _checked(path: Path, radiance: Array, clip: bool) -> Array:
    """Radiance that is finite and not negative; clipped to that if asked."""
    nan, infinite, negative = (
        int(np.count_nonzero(bad)) for bad in (np.isnan(radiance), np.isinf(radiance), radiance < 0)
    )
    if nan:
        raise InputError(f"{_WHAT} {path} has {nan} values that are NaN; mend it where it was made")
    if clip:
        return np.clip(radiance, 0.0, _GREATEST) if infinite or negative else radiance
    if infinite:
        raise InputError(
            f"{_WHAT} {path} has {infinite} infinite values, such as a sun brighter than a half float can be; save it "
            f"as 32-bit float, or take {_GREATEST:g} for them (:clip after the file, clip=True in Python)"
        )
    if negative:
        raise InputError(
            f"{_WHAT} {path} has {negative} negative values (least {radiance.min():g}), but light cannot be negative; "
            "if a filter made them, take 0 for them (:clip after the file, clip=True in Python)"
        )
    return radiance
