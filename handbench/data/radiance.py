"""Radiance pictures (.hdr): RGB and a common exponent a pixel, in lines that may be run-length coded.

EXPOSURE and COLORCORR of the header are factors that the pixels were multiplied with; they are taken out, so that
values are those that were rendered. All eight orientations and the three codings of lines are read. Pictures in CIE
XYZ and with primaries other than Rec. 709 are refused. Source: G. Ward, "Real Pixels", Graphics Gems II, 1991, and
"Radiance File Formats" of the Radiance distribution.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import read_bytes
from ..scene import Array
from .filekind import MAX_PIXELS, check_kind, check_size

_REC709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
_SIZE = re.compile(rb"([+-][XY]) (\d{1,9}) ([+-][XY]) (\d{1,9})")
_LONGEST = 1 << 16  # bytes of a header


def read_radiance(path: Path, what: str = "environment map", max_pixels: int = MAX_PIXELS) -> Array:
    """The radiance (H, W, 3) float32 in a .hdr file, upright.

    Raises `InputError` for a file that is missing, damaged, larger than `max_pixels`, in XYZ or of other primaries.
    """
    check_kind(path, what)
    data = read_bytes(path, 5 * max_pixels + _LONGEST, what)
    factor, axes, start = _header(data, path, what)
    (first, lines), (second, length) = axes
    upright = first[1] == "Y"
    check_size(path, what, length if upright else lines, lines if upright else length, max_pixels)
    if 4 * lines > len(data) - start:  # a line takes four bytes at least
        raise InputError(f"{what} {path} is damaged: its lines are cut off; get it again")
    try:
        codes = _lines(memoryview(data)[start:], lines, length)
    except (IndexError, ValueError) as error:
        raise InputError(f"{what} {path} is damaged: its lines are cut off or wrongly coded; get it again") from error
    exponent = codes[..., 3].astype(np.int32)
    # a mantissa is the lower end of its step, as common readers have it; Radiance itself takes the middle
    pixels = np.ldexp(codes[..., :3].astype(np.float32), (exponent - 136)[..., None])
    pixels[exponent == 0] = 0
    if not upright:
        pixels = pixels.swapaxes(0, 1)
    rows, columns = (first, second) if upright else (second, first)
    pixels = pixels[:: 1 if rows[0] == "-" else -1, :: 1 if columns[0] == "+" else -1]
    return np.ascontiguousarray(pixels / factor, np.float32)


def _header(data: bytes, path: Path, what: str) -> tuple[Array, tuple[tuple[str, int], tuple[str, int]], int]:
    """The factors (3,) that pixels were multiplied with, both axes with their lengths, and where pixels start."""
    end = data.find(b"\n\n", 0, _LONGEST)
    found = _SIZE.match(data, end + 2) if end >= 0 else None
    after = found.end() if found else 0
    if not found or data[after : after + 1] != b"\n" or {found[1][1:], found[3][1:]} != {b"X", b"Y"}:
        raise InputError(f"{what} {path} is damaged or no Radiance file (it has no header with a size); get it again")
    factor = np.ones(3)
    for line in data[:end].split(b"\n"):
        name, _, text = (part.strip() for part in line.decode("latin-1").partition("="))
        match name:
            case "FORMAT":
                if text != "32-bit_rle_rgbe":
                    raise InputError(
                        f"{what} {path} has the format {text!r}, which is not supported; convert it to RGB"
                    )
            case "EXPOSURE":
                factor *= _numbers(text, 1, name, path, what)
            case "COLORCORR":
                factor *= _numbers(text, 3, name, path, what)
            case "PRIMARIES":
                if not np.allclose(_numbers(text, 8, name, path, what), _REC709, atol=2e-3):
                    raise InputError(f"{what} {path} states the primaries {text}; convert it to Rec. 709")
    if not (np.isfinite(factor).all() and (factor > 0).all()):
        raise InputError(f"{what} {path} states the exposure {factor.tolist()}; expected factors above 0")
    axes = ((found[1].decode(), int(found[2])), (found[3].decode(), int(found[4])))
    return factor, axes, after + 1


def _numbers(text: str, count: int, name: str, path: Path, what: str) -> Array:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != count:
        raise InputError(f"{what} {path} has {name}={text!r}, expected {count} numbers; mend its header")
    return values


def _lines(data: memoryview, lines: int, length: int) -> Array:
    """All codes (lines, length, 4); raises `IndexError` or `ValueError` for lines that are cut off or too long."""
    codes = np.empty((lines, length, 4), np.uint8)
    at = 0
    for line in codes:
        marked = 8 <= length < 32768 and bytes(data[at : at + 2]) == b"\x02\x02" and data[at + 2] < 128
        if marked:
            if (data[at + 2] << 8) + data[at + 3] != length:
                raise ValueError("a line of another length")
            at = _planes(data, at + 4, line)
        else:
            at = _pixels(data, at, line)
    return codes


def _planes(data: memoryview, at: int, line: Array) -> int:
    """A line of four planes, each of runs (128 + n, value) and of n values as they are; where the next begins."""
    length = len(line)
    for plane in range(4):
        values, x = line[:, plane], 0
        while x < length:
            count = data[at]
            stop = x + (count - 128 if count > 128 else count)
            if count == 0 or stop > length:
                raise ValueError("a run beyond its line")
            if count > 128:
                values[x:stop] = data[at + 1]
                at += 2
            else:
                values[x:stop] = np.frombuffer(data, np.uint8, count, at + 1)
                at += 1 + count
            x = stop
    return at


def _pixels(data: memoryview, at: int, line: Array) -> int:
    """A line of pixels as they are, where (1, 1, 1, n) repeats the last n times; several in a row are digits of n."""
    length, x, shift = len(line), 0, 0
    if at + 4 * length <= len(data):
        plain = np.frombuffer(data, np.uint8, 4 * length, at).reshape(length, 4)
        if not (plain[:, :3] == 1).all(axis=1).any():
            line[:] = plain
            return at + 4 * length
    while x < length:
        pixel = np.frombuffer(data, np.uint8, 4, at)
        at += 4
        if pixel[0] == pixel[1] == pixel[2] == 1:
            stop = x + (int(pixel[3]) << shift)
            if x == 0 or stop > length:
                raise ValueError("a run beyond its line")
            line[x:stop] = line[x - 1]
            x, shift = stop, shift + 8
        else:
            line[x] = pixel
            x, shift = x + 1, 0
    return at
