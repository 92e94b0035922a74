"""Cameras in COLMAP's model folders: cameras.txt and images.txt, or the same as .bin; world to camera, OpenCV axes."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ...errors import InputError
from ...files import read_bytes, read_text
from ...scene import Array

_LIMIT = 1 << 30
_MODELS = {0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4)}  # those without distortion: name, parameters
_NAMES = dict(_MODELS.values())

Calibration = tuple[Array, tuple[int, int]]


def read_colmap(folder: Path) -> dict[str, tuple[Array, Array, tuple[int, int]]]:
    """By picture: K (3, 3), world_to_camera (3, 4) in the model's units, and width and height.

    Raises `InputError` for a folder that holds no model, a damaged one, and lenses that distort.
    """
    text = (folder / "cameras.txt").exists()
    if not text and not (folder / "cameras.bin").exists():
        raise InputError(f"folder {folder} has neither cameras.txt nor cameras.bin; give COLMAP's model, as sparse/0")
    try:
        cameras = dict((_text_cameras if text else _binary_cameras)(folder))
        found = {}
        for name, camera, quaternion, translation in (_text_images if text else _binary_images)(folder):
            if camera not in cameras:
                raise InputError(f"folder {folder}: picture {name} has camera {camera}, which the model lacks")
            rotation = Rotation.from_quat(np.roll(quaternion, -1)).as_matrix()  # COLMAP's w comes first
            found[name] = (cameras[camera][0], np.c_[rotation, translation], cameras[camera][1])
    except InputError:
        raise
    except (ValueError, struct.error, IndexError, UnicodeDecodeError, OverflowError) as error:
        raise InputError(f"COLMAP's model in {folder} is damaged ({error}); export it anew") from error
    return found


def _calibration(folder: Path, model: str, size: tuple[int, int], parameters: list[float]) -> Calibration:
    if model not in _NAMES:
        raise InputError(f"folder {folder}: camera model {model} distorts; undistort the pictures (image_undistorter)")
    across, down, x, y = parameters if len(parameters) == 4 else (parameters[0], *parameters)
    return np.array([[across, 0, x], [0, down, y], [0, 0, 1]], np.float64), size


def _text_cameras(folder: Path) -> Iterator[tuple[int, Calibration]]:
    for line in read_text(folder / "cameras.txt", _LIMIT, "camera file").splitlines():
        if line.strip() and not line.startswith("#"):
            number, model, width, height, *parameters = line.split()
            yield int(number), _calibration(folder, model, (int(width), int(height)), [float(p) for p in parameters])


def _text_images(folder: Path) -> Iterator[tuple[str, int, Array, Array]]:
    lines = [
        line
        for line in read_text(folder / "images.txt", _LIMIT, "camera file").splitlines()
        if not line.startswith("#")
    ]
    for line in lines[::2]:  # every second one lists points, and may be empty
        if line.strip():
            _, *numbers, camera, name = line.split(maxsplit=9)
            placed = np.array(numbers, np.float64)
            yield name.strip(), int(camera), placed[:4], placed[4:7]


def _binary_cameras(folder: Path) -> Iterator[tuple[int, Calibration]]:
    content = read_bytes(folder / "cameras.bin", _LIMIT, "camera file")
    (count,), at = struct.unpack_from("<Q", content), 8
    for _ in range(count):
        number, model, width, height = struct.unpack_from("<iiQQ", content, at)
        if model not in _MODELS:
            _calibration(folder, f"number {model}", (width, height), [])
        name, parameters = _MODELS[model]
        yield (
            number,
            _calibration(folder, name, (width, height), list(struct.unpack_from(f"<{parameters}d", content, at + 24))),
        )
        at += 24 + 8 * parameters


def _binary_images(folder: Path) -> Iterator[tuple[str, int, Array, Array]]:
    content = read_bytes(folder / "images.bin", _LIMIT, "camera file")
    (count,), at = struct.unpack_from("<Q", content), 8
    for _ in range(count):
        _, *placed, camera = struct.unpack_from("<i7di", content, at)
        end = content.index(b"\0", at + 64)
        name = content[at + 64 : end].decode()
        (points,) = struct.unpack_from("<Q", content, end + 1)
        at = end + 9 + 24 * points
        yield name, camera, np.array(placed[:4]), np.array(placed[4:])
