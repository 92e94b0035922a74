"""KTX 1 textures of radiance: cube maps, and equirectangular pictures, in the floating-point formats of OpenGL.

Only the first mip level is read. Source: "KTX File Format Specification", version 1, Khronos.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..files import read_bytes
from ..scene import Array
from .filekind import MAX_PIXELS, check_kind, check_size

_MAGIC = b"\xabKTX 11\xbb\r\n\x1a\n"
_PACKED = 0x8C3A  # R11F_G11F_B10F
_FLOATS: dict[int, tuple[np.dtype[Any], int]] = {
    0x881B: (np.dtype("<f2"), 3),  # RGB16F
    0x881A: (np.dtype("<f2"), 4),  # RGBA16F
    0x8815: (np.dtype("<f4"), 3),  # RGB32F
    0x8814: (np.dtype("<f4"), 4),  # RGBA32F
}
_NAMES = "R11F_G11F_B10F, RGB16F, RGBA16F, RGB32F or RGBA32F"
_LARGEST = 1024  # texels a side of a cube map: beyond, a map made of it takes gigabytes
_HEADER = 1 << 20  # bytes of key-value pairs


def read_ktx(path: Path, what: str = "cube map", max_pixels: int = MAX_PIXELS) -> Array:
    """The pictures (F, H, W, 3) float32 of a KTX 1 file: six square faces, order +x -x +y -y +z -z, or one picture.

    Alpha is left out. Raises `InputError` for a file that is missing, damaged, of another format, or larger than
    `max_pixels` in all, and for a cube map of more than 1,024 texels a side.
    """
    check_kind(path, what)
    data = read_bytes(path, 24 * max_pixels + _HEADER, what)  # 16 bytes a texel, and a third more for mip levels
    if len(data) < 68 or data[:12] != _MAGIC or data[12:16] != b"\x01\x02\x03\x04":
        raise InputError(f"{what} {path} is no little-endian KTX 1 file; convert it to one, to .exr or to .hdr")
    # some writers put the internal format into glType and glFormat too, so only this one field tells
    internal, _, width, height, depth, _, faces, _, extra = struct.unpack_from("<9I", data, 28)
    if internal != _PACKED and internal not in _FLOATS:
        raise InputError(f"{what} {path} is in format 0x{internal:x}; expected {_NAMES}")
    if depth > 1 or faces not in (1, 6) or (faces == 6 and width != height):
        raise InputError(f"{what} {path} is {faces} faces of {width}x{height}; expected 6 square faces, or 1 picture")
    check_size(path, what, width, faces * height, max_pixels)
    if faces == 6 and width > _LARGEST:
        raise InputError(f"{what} {path} is a cube of {width} texels a side; make it at most {_LARGEST}")
    kind, channels = _FLOATS.get(internal, (np.dtype("<u4"), 1))
    line = -(-width * channels * kind.itemsize // 4) * 4  # lines begin at multiples of four bytes
    start = 64 + extra + 4  # header, key-value pairs, size of one face
    end = start + faces * height * line
    if len(data) < end:
        raise InputError(f"{what} {path} is damaged: it ends after {len(data)} of {end} bytes; get it again")
    lines = np.frombuffer(data[start:end], np.uint8).reshape(faces, height, line)
    values = np.ascontiguousarray(lines[..., : width * channels * kind.itemsize]).view(kind)
    if internal == _PACKED:
        return unpack_11_11_10(values)
    return values.reshape(faces, height, width, channels)[..., :3].astype(np.float32)


def unpack_11_11_10(packed: Array) -> Array:
    """Unsigned floats of 11, 11 and 10 bits in uint32 (...) as float32 (..., 3); red is in the lowest bits.

    They are float16 without a sign and with the low bits of the mantissa cut off.
    """
    halves = np.stack([(packed & 0x7FF) << 4, (packed >> 11 & 0x7FF) << 4, (packed >> 22) << 5], axis=-1)
    return halves.astype(np.uint16).view(np.float16).astype(np.float32)
