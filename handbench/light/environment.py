"""Environment maps: equirectangular radiance (H, W, 3), exact in solid angle and power.

Texel (i, j) spans polar angles theta in [i, i+1] pi/H from +y and azimuths phi in [j, j+1] 2 pi/W; its centre
looks to (sin theta sin phi, cos theta, -sin theta cos phi). So the left border looks to -z, the first quarter
to +x, the middle to +z and the third quarter to -x: the picture is seen from inside, not mirrored.
Radiance is constant within a texel.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..data.exr import read_channels, stack
from ..data.exrheader import colour_channels, read_parts, the_part
from ..data.filekind import MAX_PIXELS
from ..data.radiance import read_radiance
from ..errors import InputError
from ..scene import Array, Environment

_WHAT = "environment map"
_GREATEST = 65504.0  # of half floats


def directions(height: int, width: int, rows: slice = slice(None)) -> Array:
    """Unit directions to the centres of the texels, (H, W, 3) float64; of some rows if asked."""
    theta = ((np.arange(height)[:, None] + 0.5) * (np.pi / height))[rows]
    phi = (np.arange(width) + 0.5) * (2.0 * np.pi / width)
    up = np.broadcast_to(np.cos(theta), (len(theta), width))
    return np.stack([np.sin(theta) * np.sin(phi), up, -np.sin(theta) * np.cos(phi)], axis=-1)


def solid_angles(height: int, width: int) -> Array:
    """Solid angles of the texels, (H, W) float64 steradians; their sum is 4 pi."""
    # cos a - cos b as a product: the difference would lose digits at the poles
    bands = 2.0 * np.sin(0.5 * np.pi / height) * np.sin((np.arange(height) + 0.5) * (np.pi / height))
    return np.repeat(bands[:, None], width, axis=1) * (2.0 * np.pi / width)


def resize(environment: Environment, height: int, width: int) -> Environment:
    """The map at another size: each texel is the mean radiance over its solid angle, so power is kept.

    Raises `InputError` for a size below 1 x 1.
    """
    if height < 1 or width < 1:
        raise InputError(f"environment {environment.name!r} cannot have {height}x{width} texels; give at least 1x1")
    old_height, old_width = environment.radiance.shape[:2]
    if (old_height, old_width) == (height, width):
        return environment
    rows = _overlaps(*(-np.cos(np.linspace(0.0, np.pi, n + 1)) for n in (height, old_height)))
    columns = _overlaps(*(np.linspace(0.0, 1.0, n + 1) for n in (width, old_width)))
    banded = (rows @ environment.radiance.reshape(old_height, -1)).reshape(height, old_width, 3)
    return Environment(environment.name, columns @ banded)


def _overlaps(new: Array, old: Array) -> Array:
    """The share of each old interval in each new one, (new, old); intervals between increasing edges."""
    low = np.maximum(new[:-1, None], old[None, :-1])
    high = np.minimum(new[1:, None], old[None, 1:])
    return np.maximum(high - low, 0.0) / np.diff(new)[:, None]


def rotate(environment: Environment, angle: float) -> Environment:
    """The environment turned by `angle` radians about +y (right-handed: +z goes to +x at a quarter turn).

    Texels are shared between two columns where the turn is no whole number of columns; power is kept.
    Raises `InputError` for an angle that is NaN or infinite.
    """
    if not np.isfinite(angle):
        raise InputError(f"environment {environment.name!r} cannot be turned by {angle} radians; give a finite angle")
    width = environment.radiance.shape[1]
    shift = -angle / (2.0 * np.pi) * width  # azimuth here falls under a right-handed turn
    if abs(shift - round(shift)) < 1e-9 * width:  # rounding must not leak light into dark texels
        shift = round(shift)
    whole = int(np.floor(shift))
    part = shift - whole
    radiance = environment.radiance.astype(np.float64)
    turned = (1.0 - part) * np.roll(radiance, whole, axis=1) + part * np.roll(radiance, whole + 1, axis=1)
    return Environment(environment.name, turned)


def to_directional(
    environment: Environment, height: int = 16, width: int = 32, dark: bool = False
) -> tuple[Array, Array]:
    """The map as distant lights: unit directions (N, 3) and irradiance (N, 3) float64; dark texels are left out.

    Each texel of the reduced map is a light at its centre whose irradiance is radiance times solid angle; `dark`
    keeps those without any.
    """
    small = resize(environment, height, width)
    where = directions(height, width).reshape(-1, 3)
    power = (small.radiance.astype(np.float64) * solid_angles(height, width)[..., None]).reshape(-1, 3)
    if not dark:
        lit = power.any(axis=1)
        where, power = where[lit], power[lit]
    return where, power


def read(
    path: Path,
    *,
    clip: bool = False,
    layer: str | None = None,
    part: str | None = None,
    max_pixels: int = MAX_PIXELS,
) -> Environment:
    """An equirectangular .exr or .hdr file as an environment named after the file.

    With `clip`, negative radiance becomes 0 (sharpening filters make some) and infinite radiance 65504, the greatest
    half float (a sun beyond it). `layer` and `part` choose within an EXR.
    Raises `InputError` for a file that is missing, damaged, of another kind, larger than `max_pixels`, cropped, a cube
    map, or of other colours than linear Rec. 709, and for NaN, infinite or negative radiance.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".exr":
        radiance = _read_exr(path, layer, part, max_pixels)
    elif suffix in (".hdr", ".rgbe") or not path.exists():
        radiance = read_radiance(path, _WHAT, max_pixels)
    else:
        raise InputError(f"{_WHAT} {path} is neither .exr nor .hdr; convert it to one of them")
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
            f"as 32-bit float, or read it with clip=True to take {_GREATEST:g}"
        )
    if negative:
        raise InputError(
            f"{_WHAT} {path} has {negative} negative values (least {radiance.min():g}), but light cannot be negative; "
            "if a filter made them, read it with clip=True to take 0"
        )
    return radiance
