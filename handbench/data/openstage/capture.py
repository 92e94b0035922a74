"""Reader of an open light stage folder."""

from __future__ import annotations

import hashlib
import json
import re
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...files import JSON_LIMIT, read_bytes, read_text
from ...memory import physical_memory
from ...recording import Need
from ...scene import Array, Camera, Directional, Environment, Frame, Group, Light, Mesh, Observation, Pose, Topology
from ..arrays import read_arrays
from ..capture import Capture
from ..exr import read_exr, stack
from .inventory import olat_name, recorded
from .presets import SCHEMA

_ARRAYS = 256 << 20  # bytes of a file of vertices
_WIDEST = 1 << 15  # pixels a side of a picture
_CACHE_SHARE = 1 / 16  # of the machine's memory, for single-light images as half floats: 295 kB each at `quick`


class OpenStage(Capture):
    """A generated capture; groups and fully lit frames are the exact weighted sums of single-light images."""

    hand = "openhand"

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        path = folder / "capture.json"
        text, self._manifest = read_manifest(path)
        try:
            self.name = f"openstage-{self._manifest['preset']['name']}"
            self.digest = hashlib.sha256(text.encode()).hexdigest()[:16]
            self._weights = {
                entry["name"]: np.asarray(entry["weights"])
                for entry in self._manifest["lightings"]
                if entry["weights"] is not None
            }
            self._sums = recorded(folder, self._manifest)
            self._sound: set[str] = set()  # files that were compared with their sums
            self._frames = tuple(self._build())
        except InputError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
            raise InputError(f"{path} is damaged ({error} is missing or wrong); make the capture again") from error
        camera = self._frames[0].camera
        kept = int(_CACHE_SHARE * (physical_memory() or 8e9) / (6 * camera.height * camera.width))
        self._read = lru_cache(max(1, kept))(self._read_image)
        self._full = lru_cache(256)(self._sum)  # sums of all lights, which every method's mean textures are made from
        self._geometry = lru_cache(256)(self._read_geometry)

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    @property
    def offers(self) -> frozenset[Need]:
        return super().offers | {"depth", "normal"}

    def observe(self, frame: Frame) -> Observation:
        camera = frame.camera
        folder = f"{frame.subject}/{frame.pose_name}/{camera.name}"
        if frame.kind == "full":
            image = self._full(folder, frame.lighting, camera.height, camera.width)
        elif frame.lighting in self._weights:
            image = self._sum(folder, frame.lighting, camera.height, camera.width)
        else:
            image = self._read(f"{folder}/{frame.lighting}.exr", camera.height, camera.width).astype(np.float32)
        return Observation(image, *self._geometry(f"{folder}/geometry.exr", camera.height, camera.width))

    def _sum(self, folder: str, lighting: str, height: int, width: int) -> Array:
        weights = self._weights[lighting]
        image = np.zeros((height, width, 3), np.float32)
        for i in np.flatnonzero(weights):
            image += np.float32(weights[i]) * self._read(f"{folder}/{olat_name(int(i))}.exr", height, width)
        image.flags.writeable = False  # the fully lit ones are shared
        return image

    def _read_image(self, name: str, height: int, width: int) -> Array:
        path = self.folder / name
        image = _sized(stack(read_exr(path), ("R", "G", "B"), path), height, width, path).astype(np.float16)
        self._compare(name)
        return image

    def _read_geometry(self, name: str, height: int, width: int) -> tuple[Array, Array, Array, Array]:
        path = self.folder / name
        channels = read_exr(path)
        self._compare(name)
        alpha = _sized(stack(channels, ("A",), path), height, width, path)[..., 0]
        normal = stack(channels, ("normal.X", "normal.Y", "normal.Z"), path)
        depth, uv = stack(channels, ("depth.Z",), path)[..., 0], stack(channels, ("uv.U", "uv.V"), path)
        for array in (alpha, normal, depth, uv):
            array.flags.writeable = False  # shared by all frames of the view
        return alpha, normal, depth, uv

    def _build(self) -> list[Frame]:
        manifest = self._manifest
        arrays = self._arrays("topology.npz")
        topology = Topology(arrays["faces"], arrays["uvs"], arrays["uv_faces"])
        cameras = [Camera(**{**c, "K": np.asarray(c["K"])}) for c in manifest["cameras"]]
        olats = [Directional(np.asarray(o["direction"]), np.asarray(o["irradiance"])) for o in manifest["olat"]]
        lights = [(e["name"], e["kind"], self._light(e["name"], e["weights"], olats)) for e in manifest["lightings"]]
        frames = []
        for person in manifest["subjects"]:
            for act in person["poses"]:
                mesh = Mesh(self._arrays(f"{person['name']}/{act['name']}/tracked.npy"), topology)
                pose = Pose(act["joints"], act["rotation"], act["translation"])
                frames += [
                    Frame(person["name"], act["name"], name, pose, mesh, camera, light, act["segment"], kind)
                    for camera in cameras
                    for name, kind, light in lights
                ]
        return frames

    def _light(self, name: str, weights: list[float] | None, olats: list[Directional]) -> Light:
        if weights is None:
            file = f"environments/{name}.exr"
            path = self.folder / file
            light = Environment(name.removeprefix("env-"), stack(read_exr(path), ("R", "G", "B"), path))
            self._compare(file)
            return light
        members = tuple(olat.scaled(w) if w != 1 else olat for olat, w in zip(olats, weights, strict=True) if w > 0)
        return members[0] if len(members) == 1 else Group(members)

    def _arrays(self, name: str) -> Any:
        found = _load(self.folder / name)
        self._compare(name)
        return found

    def _compare(self, name: str) -> None:
        """Once a file: what was read is what was generated. Raises `InputError` if it is not."""
        if name not in self._sound:
            path = self.folder / name
            if hashlib.sha256(path.read_bytes()).hexdigest() != self._sums[name]:
                raise InputError(
                    f"{path} is damaged: it is not what was generated; delete it and make the capture again"
                )
            self._sound.add(name)


def read_manifest(path: Path) -> tuple[str, dict[str, Any]]:
    """Text and values of a capture.json; raises `InputError` for one that is damaged or of another schema."""
    try:
        text = read_text(path, JSON_LIMIT, "capture")
        manifest = json.loads(text)
        schema = manifest["schema"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{path} cannot be read ({error}); delete it and make the capture again") from error
    if schema != SCHEMA:
        raise InputError(f"{path} has schema {schema}, this version reads {SCHEMA}; make the capture again")
    try:
        _check(manifest)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        wrong = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else error
        raise InputError(f"{path} is damaged ({wrong}); delete it and make the capture again") from error
    return text, manifest


def _check(manifest: dict[str, Any]) -> None:
    """Raise `KeyError`, `TypeError` or `ValueError` for a manifest that no generator writes, before it is followed."""
    for kind in ("cameras", "olat", "lightings", "subjects"):
        if not isinstance(manifest[kind], list) or not manifest[kind]:
            raise ValueError(f"it has no {kind}")
    for camera in manifest["cameras"]:
        size = camera["width"], camera["height"]
        if any(type(side) is not int or not 0 < side <= _WIDEST for side in size):
            raise ValueError(f"camera {camera['name']!r} has {size[0]} x {size[1]} pixels, at most {_WIDEST} a side")
    for lighting in manifest["lightings"]:
        if lighting["weights"] is not None and len(lighting["weights"]) != len(manifest["olat"]):
            raise ValueError(f"lighting {lighting['name']!r} has {len(lighting['weights'])} weights for its lights")
    poses = [pose for person in manifest["subjects"] for pose in person["poses"]]
    for kind in ("cameras", "lightings", "subjects"):
        _check_names(kind, manifest[kind])
    _check_names("poses", poses)


def _check_names(kind: str, entries: list[dict[str, Any]]) -> None:
    """Names become parts of paths, so they are words, and nothing else."""
    for entry in entries:
        if not isinstance(entry["name"], str) or not re.fullmatch(r"\w[\w.-]*", entry["name"]):
            raise ValueError(f"{entry['name']!r} cannot be the name of one of its {kind}")


def _load(path: Path) -> Any:
    """A numpy file: an array, or a mapping of arrays; raises `InputError` if it is missing or damaged."""
    if path.suffix == ".npz":
        return read_arrays(path)
    try:
        found = np.load(BytesIO(read_bytes(path, _ARRAYS)))
        return found if isinstance(found, np.ndarray) else {name: found[name] for name in found.files}
    except Exception as error:  # of numpy, zip and zlib: whatever a flipped byte leads to
        raise InputError(f"{path} cannot be read ({error}); delete it and make the capture again") from error


def _sized(image: Array, height: int, width: int, path: Path) -> Array:
    if image.shape[:2] != (height, width):
        got = f"{image.shape[1]}x{image.shape[0]}"
        raise InputError(f"image {path} is {got}, its camera says {width}x{height}; make the capture again")
    return image
