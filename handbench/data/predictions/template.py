"""What a protocol asks, as files: for software that is not handbench.

FOLDER/manifest.json                    to be completed by whoever draws the pictures
FOLDER/asked/queries.json               every query, and the frames that training and enrolment may see
FOLDER/asked/meshes/SUBJECT/POSE.npz    vertices, faces, uvs, uv_faces
FOLDER/asked/environments/N.exr         radiance of the environments, equirectangular, row 0 = +y
FOLDER/asked/images/….exr               with images: the recorded pictures of training and enrolment, never others
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, assert_never

import numpy as np

from ...errors import InputError
from ...files import writing
from ...method import Progress, silent
from ...scene import Camera, Directional, Environment, Frame, Group, Light, Mesh, Observation, Point, Unknown
from ..exr import rgb, write_exr
from .folder import ASKED, Asked, picture_path
from .manifest import MANIFEST

_CONVENTIONS = (
    "metres, right-handed world, +y up",
    "cameras: OpenCV (x right, y down, z forward), K in pixels with pixel centres at +0.5, world_to_camera 3x4",
    "lights: direction is the unit vector to the light, irradiance that of a facing surface, intensity per steradian",
    "environments: radiance, equirectangular; row 0 is up, the left border looks to -z, the first quarter to +x",
    "pictures: linear Rec. 709, premultiplied by alpha over black, OpenEXR with float or half channels R, G, B, A",
    "joints: axis-angle in radians, in the order of the capture's hand model",
)


@dataclass
class _Tables:
    """What frames share, each once: rows of JSON values, and the number of each object's row."""

    folder: Path
    cameras: list[dict[str, Any]] = field(default_factory=list)
    lights: list[dict[str, Any]] = field(default_factory=list)
    poses: dict[str, dict[str, Any]] = field(default_factory=dict)
    _numbers: dict[int, int] = field(default_factory=dict)
    _environments: dict[int, str] = field(default_factory=dict)

    def row(self, frame: Frame) -> dict[str, Any]:
        """A frame as JSON values; what it refers to is entered."""
        if frame.pose_key not in self.poses:
            self.poses[frame.pose_key] = self._pose(frame)
        return {
            "key": frame.key,
            "subject": frame.subject,
            "pose": frame.pose_key,
            "lighting": frame.lighting,
            "kind": frame.kind,
            "camera": self._number(frame.camera, self.cameras, _camera),
            "light": self._number(frame.light, self.lights, self._light),
        }

    def _number(self, shared: Any, rows: list[dict[str, Any]], told: Callable[[Any], dict[str, Any]]) -> int:
        if id(shared) not in self._numbers:
            rows.append(told(shared))
            self._numbers[id(shared)] = len(rows) - 1
        return self._numbers[id(shared)]

    def _pose(self, frame: Frame) -> dict[str, Any]:
        path = f"{ASKED}/meshes/{frame.pose_key}.npz"
        told: dict[str, Any] = {}
        if frame.mesh is not None:
            self._mesh(path, frame.mesh)
            told["mesh"] = path
        if (pose := frame.pose) is not None:
            values = {"joints": pose.joints, "rotation": pose.rotation, "translation": pose.translation}
            told |= {name: value.tolist() for name, value in values.items()}
        return told

    def _mesh(self, path: str, mesh: Mesh) -> None:
        topology = mesh.topology
        arrays: dict[str, Any] = {"vertices": mesh.vertices, "faces": topology.faces}
        if topology.uvs is not None and topology.uv_faces is not None:
            arrays |= {"uvs": topology.uvs, "uv_faces": topology.uv_faces}
        place = self.folder / path
        place.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(place, **arrays)

    def _light(self, light: Light) -> dict[str, Any]:
        match light:
            case Group():
                return {"type": "group", "lights": [self._light(member) for member in light.lights]}
            case Directional():
                values = {"direction": light.direction, "irradiance": light.irradiance}
                return {"type": "directional", **{name: value.tolist() for name, value in values.items()}}
            case Point():
                values = {"position": light.position, "intensity": light.intensity}
                return {"type": "point", **{name: value.tolist() for name, value in values.items()}}
            case Environment():
                return {"type": "environment", "name": light.name, "radiance": self._environment(light)}
            case Unknown():
                return {"type": "unknown", "name": light.name}
            case _:
                assert_never(light)

    def _environment(self, light: Environment) -> str:
        if id(light) not in self._environments:
            path = f"{ASKED}/environments/{len(self._environments)}.exr"
            (self.folder / path).parent.mkdir(parents=True, exist_ok=True)
            write_exr(self.folder / path, rgb(light.radiance, dtype=np.float32))
            self._environments[id(light)] = path
        return self._environments[id(light)]


def write_template(
    folder: Path,
    asked: Asked,
    scored: Iterable[Frame],
    train: Sequence[Frame],
    enrol: Sequence[Frame],
    observe: Callable[[Frame], Observation] | None = None,
    progress: Progress = silent,
) -> None:
    """Write what is asked into a new folder, whole or not at all; `observe` gives the images of training and enrolment.

    Raises `InputError` if the folder has something in it, `StorageError` if it cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} exists and is not empty; name a new folder")
    part = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    try:
        with writing(folder, "name another folder"):
            part.mkdir(parents=True)
            tables = _Tables(part)
            rows = {name: [tables.row(f) for f in frames] for name, frames in (("train", train), ("enrol", enrol))}
            shown = {frame.key: frame for frame in (*train, *enrol)} if observe else {}
            for i, frame in enumerate(shown.values()):
                _write_image(picture_path(part / ASKED / "images", frame.key), observe, frame)  # type: ignore[arg-type]
                progress(i + 1, len(shown))
            queries = {
                "conventions": _CONVENTIONS,
                **{
                    key: value
                    for key, value in asked.manifest.content().items()
                    if key.endswith(("protocol", "digest"))
                },
                "images": f"{ASKED}/images" if observe else None,
                "queries": [tables.row(frame) for frame in scored],
                **rows,
                "cameras": tables.cameras,
                "lights": tables.lights,
                "poses": tables.poses,
            }
            _write_json(part / ASKED / "queries.json", queries)
            _write_json(part / MANIFEST, asked.manifest.content())
            if folder.exists():
                folder.rmdir()
            part.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _write_image(path: Path, observe: Callable[[Frame], Observation], frame: Frame) -> None:
    observation = observe(frame)
    path.parent.mkdir(parents=True, exist_ok=True)
    alpha = {} if observation.alpha is None else {"A": observation.alpha}
    write_exr(path, {**rgb(observation.image, dtype=np.float32), **alpha})


def _write_json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _camera(camera: Camera) -> dict[str, Any]:
    size = {"name": camera.name, "width": camera.width, "height": camera.height}
    return {**size, "K": camera.K.tolist(), "world_to_camera": camera.world_to_camera.tolist()}
