"""What a protocol asks, as files: for software that is not handbench. They tell what a method here is told, no more.

FOLDER/manifest.json                    to be completed by whoever draws the pictures
FOLDER/asked/queries.json               every query, and the frames that training and enrolment may see
FOLDER/asked/meshes/SUBJECT/POSE.npz    vertices, faces, and uvs, uv_faces
FOLDER/asked/environments/N.exr         radiance of the environments, equirectangular, row 0 = +y
FOLDER/asked/images/….exr               with images: the recorded pictures of training and enrolment, never others
FOLDER/asked/images/….npz               beside them what else was recorded: depth, normals, UVs, key points, scans
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, count
from pathlib import Path
from typing import Any, assert_never

import numpy as np

from ...errors import InputError
from ...files import writing
from ...method import Progress, silent
from ...recording import Recording
from ...scene import (
    Camera,
    Directional,
    Environment,
    Frame,
    Group,
    Light,
    Mesh,
    Observation,
    Point,
    Query,
    Uncalibrated,
    Unknown,
)
from ..exr import rgb, write_exr
from ..predictionfiles import nested_path
from .folder import ASKED, Asked
from .manifest import DISPLAYED, MANIFEST, METHOD_NAME

_CONVENTIONS = (
    "metres, right-handed world, +y up",
    "cameras: OpenCV (x right, y down, z forward), K in pixels with pixel centres at +0.5, world_to_camera 3x4",
    "lights: direction is the unit vector to the light, irradiance that of a facing surface, intensity per steradian",
    "environments: radiance, equirectangular; row 0 is up, the left border looks to -z, the first quarter to +x",
    "pictures: linear Rec. 709, premultiplied by alpha over black, OpenEXR with float or half channels R, G, B, A",
    "joints: axis-angle in radians, in the order of the capture's hand model",
    f"manifest.json: method is {METHOD_NAME}; title is what tables call the row",
    f'PNG files instead: sRGB, straight alpha, with colour "{DISPLAYED}" in manifest.json',
)


@dataclass
class _Tables:
    """What frames share, each once: rows of JSON values, and the number of each object's row."""

    folder: Path
    cameras: list[dict[str, Any]] = field(default_factory=list)
    lights: list[dict[str, Any]] = field(default_factory=list)
    poses: list[dict[str, Any]] = field(default_factory=list)
    _numbers: dict[tuple[int, ...], int] = field(default_factory=dict)
    _rows: dict[str, int] = field(default_factory=dict)
    _meshes: dict[str, str] = field(default_factory=dict)
    _environments: dict[int, str] = field(default_factory=dict)
    _held: list[Any] = field(default_factory=list)  # what is known by its identity lives as long as that counts

    def row(self, query: Query) -> dict[str, Any]:
        """A query or a frame as JSON values; what it refers to is entered."""
        shape = query.shape if isinstance(query, Frame) else None
        return {
            "key": query.key,
            "subject": query.subject,
            "pose": self._number(self.poses, partial(self._pose, query), query.pose, query.mesh, shape),
            "lighting": query.lighting,
            **(_recorded(query) if isinstance(query, Frame) else {}),
            "camera": self._number(self.cameras, partial(_camera, query.camera), query.camera),
            "light": self._number(self.lights, partial(self._light, query.light), query.light),
        }

    def _number(self, rows: list[dict[str, Any]], tell: Callable[[], dict[str, Any]], *shared: Any) -> int:
        """The number of the row that tells of some objects: equal ones have the same, whoever made them."""
        objects = (id(rows), *map(id, shared))
        if objects not in self._numbers:
            told = tell()
            content = f"{id(rows)} {json.dumps(told, sort_keys=True)}"
            if content not in self._rows:
                rows.append(told)
                self._rows[content] = len(rows) - 1
            self._numbers[objects] = self._rows[content]
            self._held.append(shared)
        return self._numbers[objects]

    def _pose(self, query: Query) -> dict[str, Any]:
        told: dict[str, Any] = {"name": query.pose_key}
        if query.mesh is not None:
            told["mesh"] = self._mesh(query.pose_key, query.mesh)
        if (pose := query.pose) is not None:
            values = {"joints": pose.joints, "rotation": pose.rotation, "translation": pose.translation}
            told |= {name: value.tolist() for name, value in values.items()}
        if isinstance(query, Frame) and query.shape is not None:
            told["shape"] = query.shape.tolist()
        return told

    def _mesh(self, name: str, mesh: Mesh) -> str:
        """The file of a mesh. Meshes of one pose that differ, as one without its UVs does, have a file each."""
        topology = mesh.topology
        content = f"{topology.digest} {hashlib.sha256(mesh.vertices.tobytes()).hexdigest()}"
        if content not in self._meshes:
            taken = set(self._meshes.values())
            names = chain([name], (f"{name}-{again}" for again in count(2)))
            path = next(path for path in (f"{ASKED}/meshes/{each}.npz" for each in names) if path not in taken)
            arrays: dict[str, Any] = {"vertices": mesh.vertices, "faces": topology.faces}
            if topology.uvs is not None and topology.uv_faces is not None:
                arrays |= {"uvs": topology.uvs, "uv_faces": topology.uv_faces}
            place = self.folder / path
            place.parent.mkdir(parents=True, exist_ok=True)
            np.savez_compressed(place, **arrays)
            self._meshes[content] = path
        return self._meshes[content]

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
    training: Recording,
    enrolments: Sequence[Recording],
    images: bool = False,
    progress: Progress = silent,
) -> None:
    """Write what is asked into a new folder, whole or not at all; with `images`, what training and enrolment saw too.

    The recordings are what a method sees that trains, and that enrols each subject. A frame of one key in both is the
    same, and its picture is training's. Raises `InputError` if the folder has something in it, `StorageError` if it
    cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} exists and is not empty; name a new folder")
    part = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    try:
        with writing(folder, "name another folder"):
            part.mkdir(parents=True)
            tables = _Tables(part)
            rows = {
                "train": [tables.row(frame) for frame in training.frames],
                "enrol": [tables.row(frame) for seen in enrolments for frame in seen.frames],
            }
            if images:
                shown = {frame.key: (seen, frame) for seen in (*enrolments, training) for frame in seen.frames}
                for i, (seen, frame) in enumerate(shown.values()):
                    _write_observation(nested_path(part / ASKED / "images", frame.key), seen.observe(frame))
                    progress(i + 1, len(shown))
            queries = {
                "conventions": _CONVENTIONS,
                **{
                    key: value
                    for key, value in asked.manifest.content().items()
                    if key.endswith(("protocol", "digest"))
                },
                "images": f"{ASKED}/images" if images else None,
                "queries": [tables.row(query) for query in asked.queries.values()],
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


def _recorded(frame: Frame) -> dict[str, Any]:
    """What a frame tells beyond a query: how it was lit, and its place in a sequence."""
    return {"kind": frame.kind} | ({} if frame.moment is None else {"moment": frame.moment})


def _write_observation(path: Path, seen: Observation) -> None:
    """A picture, with alpha if it is given, and whatever else was recorded in an archive of the same name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    alpha = {} if seen.alpha is None else {"A": seen.alpha}
    write_exr(path, {**rgb(seen.image, dtype=np.float32), **alpha})
    parts = {name: getattr(seen, name) for name in ("depth", "normal", "uv", "keypoints")}
    if seen.scan is not None:
        parts |= {"scan_vertices": seen.scan.vertices, "scan_faces": seen.scan.topology.faces}
    if given := {name: values for name, values in parts.items() if values is not None}:
        np.savez_compressed(path.with_suffix(".npz"), **given)


def _write_json(path: Path, content: dict[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _camera(camera: Camera) -> dict[str, Any]:
    size = {"name": camera.name, "width": camera.width, "height": camera.height}
    if isinstance(camera, Uncalibrated):
        return size
    return {**size, "K": camera.K.tolist(), "world_to_camera": camera.world_to_camera.tolist()}
