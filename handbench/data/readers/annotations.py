"""InterHand2.6M's annotation files: annotations/SPLIT/InterHand2.6M_SPLIT_{camera,joint_3d,MANO_NeuralAnnot}.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...files import read_json
from ...scene import Array, Camera
from ..picturesize import picture_size
from .keypoints import TIPS_FIRST
from .place import lacking

_LIMIT = 2 << 30  # bytes of an annotation file
_FIT = {"pose": 48, "shape": 10, "trans": 3}


class Annotations:
    """The annotation files of a split: cameras, key points and fits of its captures."""

    def __init__(self, folder: Path, split: str, digest: Any) -> None:
        self._folder = folder
        tables = []
        for kind in ("camera", "joint_3d", "MANO_NeuralAnnot"):
            name = f"InterHand2.6M_{split}_{kind}.json"
            places = [folder / "annotations" / below / name for below in (split, "all", ".")]
            path = next((path for path in places if path.is_file()), None)
            if path is None:
                raise lacking(folder, f"annotations/{split}/{name}")
            digest.update(f"{name} {path.stat().st_size}".encode())
            tables.append(read_json(path, _LIMIT, "annotation file"))
        self._cameras, self._points, self._fits = tables

    def camera(self, capture: str, name: str, picture: Path) -> Camera:
        said = self._of(self._cameras, capture, "camera")
        identity = name.removeprefix("cam")
        try:
            rotation = np.array(said["camrot"][identity], np.float64).reshape(3, 3)
            position = 0.001 * np.array(said["campos"][identity], np.float64)
            (fx, fy), (cx, cy) = said["focal"][identity], said["princpt"][identity]
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{self._folder}: the annotations have no camera {identity} of {capture}") from error
        K = np.array([[fx, 0, cx + 0.5], [0, fy, cy + 0.5], [0, 0, 1]], np.float64)
        return Camera(name, *picture_size(picture), K, np.c_[rotation, -rotation @ position])

    def fit(self, capture: str, number: str) -> dict[str, Any] | None:
        """MANO's parameters of a moment with a single right hand; None for others."""
        frame = str(int(number))
        points = self._of(self._points, capture, "joint_3d").get(frame)
        if points is None or points.get("hand_type") != "right":
            return None
        fit = (self._of(self._fits, capture, "MANO_NeuralAnnot").get(frame) or {}).get("right")
        if not isinstance(fit, dict) or not all(key in fit for key in _FIT):
            return None
        for key, count in _FIT.items():
            value = fit[key]
            if not isinstance(value, list) or len(value) != count or not all(type(x) in (int, float) for x in value):
                raise InputError(f"{self._folder}: the fit of {capture} {frame} has no {key} of {count} numbers")
        return fit

    def joints(self, capture: str, number: str) -> tuple[Array, Array]:
        """The right hand's 21 key points in metres and whether each is valid, in our order."""
        said = self._points[capture.removeprefix("Capture")][str(int(number))]
        points = 0.001 * np.array(said["world_coord"], np.float64)[list(TIPS_FIRST)]
        return points, np.array(said["joint_valid"], np.float64).ravel()[list(TIPS_FIRST)]

    def _of(self, table: Any, capture: str, kind: str) -> dict[str, Any]:
        found = table.get(capture.removeprefix("Capture")) if isinstance(table, dict) else None
        if not isinstance(found, dict):
            raise InputError(f"{self._folder}: the annotations ({kind}) have no {capture}")
        return found
