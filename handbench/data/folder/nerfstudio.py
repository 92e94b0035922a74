"""Cameras in nerfstudio's transforms.json: camera to world, OpenGL axes (x right, y up, z back)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, shortened
from ...files import read_json
from ...scene import Array

_LIMIT = 256 << 20
_DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", None)


def read_nerfstudio(path: Path) -> dict[str, tuple[Array, Array, tuple[int, int]]]:
    """By picture, as the file names it: K (3, 3), world_to_camera (3, 4) in OpenCV's axes and the file's units, and
    width and height.

    Raises `InputError` for a file that is no transforms.json, for lens distortion, and for what is not a camera.
    """
    table = read_json(path, _LIMIT, "camera file")
    frames = table.get("frames") if isinstance(table, dict) else None
    if not isinstance(frames, list) or not frames:
        raise InputError(f"camera file {path} has no frames; give nerfstudio's transforms.json")
    found = {}
    for number, frame in enumerate(frames):
        owner = f"camera file {path} frame {number}"
        name = frame.get("file_path") if isinstance(frame, dict) else None
        if not isinstance(name, str):
            raise InputError(f"{owner}: file_path is missing; it names the picture")
        said = {**{key: value for key, value in table.items() if key != "frames"}, **frame}
        _undistorted(owner, said)
        matrix = np.array(_rows(owner, said.get("transform_matrix")), np.float64)
        rotation, centre = matrix[:3, :3] * (1.0, -1.0, -1.0), matrix[:3, 3]
        found[name.removeprefix("./")] = (
            _intrinsics(owner, said),
            np.concatenate([rotation.T, -(rotation.T @ centre)[:, None]], axis=1),
            (int(_number(owner, said, "w")), int(_number(owner, said, "h"))),
        )
    return found


def _intrinsics(owner: str, said: dict[str, Any]) -> Array:
    if "fl_x" in said:
        across = _number(owner, said, "fl_x")
    elif "camera_angle_x" in said:
        angle = _number(owner, said, "camera_angle_x")
        if not 0 < angle < math.pi:
            raise InputError(f"{owner}: camera_angle_x is {angle:g}; give radians between 0 and pi")
        across = 0.5 * _number(owner, said, "w") / math.tan(0.5 * angle)
    else:
        raise InputError(f"{owner}: fl_x is missing; give the focal length in pixels, or camera_angle_x")
    down = _number(owner, said, "fl_y") if "fl_y" in said else across
    centre = [
        _number(owner, said, name) if name in said else 0.5 * _number(owner, said, size)
        for name, size in (("cx", "w"), ("cy", "h"))
    ]
    return np.array([[across, 0, centre[0]], [0, down, centre[1]], [0, 0, 1]], np.float64)


def _undistorted(owner: str, said: dict[str, Any]) -> None:
    if said.get("camera_model") not in _MODELS:
        raise InputError(f"{owner}: camera_model is {shortened(said['camera_model'])}; undistort the pictures first")
    for name in _DISTORTION:
        if said.get(name) and abs(_number(owner, said, name)) > 1e-6:
            raise InputError(f"{owner}: the lens distorts ({name} = {said[name]:g}); undistort the pictures first")


def _rows(owner: str, value: Any) -> list[list[float]]:
    numbers = isinstance(value, list) and all(
        isinstance(row, list) and len(row) == 4 and all(isinstance(x, int | float) for x in row) for row in value
    )
    if not numbers or len(value) not in (3, 4):
        raise InputError(f"{owner}: transform_matrix is {shortened(value)}; give 4 rows of 4 numbers")
    rows: list[list[float]] = value
    return rows


def _number(owner: str, said: dict[str, Any], name: str) -> float:
    value = said.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{owner}: {name} is {shortened(value)}; give a number")
    return float(value)
