"""The lights that a plain folder tells."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, shortened
from ...scene import Array, Directional, Environment, FrameKind, Group, Light, Point, Single, Unknown
from ..environments import read_environment
from .manifest import FolderManifest
from .pattern import check_path, inside


class Lights:
    """Gives each lighting, by its name, its light and the kind of its frames; one that is not told is unknown."""

    def __init__(self, folder: Path, manifest: FolderManifest) -> None:
        members: dict[str, list[Single]] = {}
        for told in manifest.lights:
            name = told.get("name")
            if not isinstance(name, str):
                raise InputError(f"folder {folder} [[light]]: name is {shortened(name)}; give that of a lighting")
            members.setdefault(name, []).append(_light(folder, manifest, told))
        self._lights: dict[str, Light] = {
            name: found[0] if len(found) == 1 else Group(tuple(found)) for name, found in members.items()
        }
        self._unused = set(members)

    def of(self, name: str) -> tuple[Light, FrameKind]:
        self._unused.discard(name)
        light = self._lights.setdefault(name, Unknown(name))
        match light:
            case Group():
                return light, "group"
            case Directional() | Point():
                return light, "olat"
            case _:
                return light, "environment"

    def check_used(self, folder: Path) -> None:
        """Raises `InputError` for a light whose name is no frame's lighting."""
        if self._unused:
            known = ", ".join(sorted(set(self._lights) - self._unused)) or "none"
            raise InputError(
                f"folder {folder} [[light]] {min(self._unused)!r} lights no picture; lightings are {known}"
            )


def _light(folder: Path, manifest: FolderManifest, told: dict[str, Any]) -> Single:
    owner = f"folder {folder} [[light]] {told['name']!r}"
    match sorted(set(told) - {"name"}):
        case ["environment"]:
            path = inside(folder, check_path(owner, told["environment"]))
            found = read_environment(path)
            if not np.array_equal(manifest.up, np.eye(3)):
                raise InputError(f'{owner}: an environment map has +y up; say up = "y" and turn the rest')
            return Environment(told["name"], found.radiance)
        case ["direction", "irradiance"]:
            direction = _vector(owner, told, "direction")
            length = float(np.linalg.norm(direction))
            if length == 0:
                raise InputError(f"{owner}: direction is zero; give the direction from the hand to the light")
            return Directional(manifest.up @ direction / length, _vector(owner, told, "irradiance"))
        case ["intensity", "position"]:
            position = manifest.unit * manifest.up @ _vector(owner, told, "position")
            return Point(position, _vector(owner, told, "intensity"))
    raise InputError(f"{owner}: give environment, direction and irradiance, or position and intensity")


def _vector(owner: str, told: dict[str, Any], key: str) -> Array:
    value = told[key]
    if isinstance(value, list) and len(value) == 3 and all(type(x) in (int, float) for x in value):
        return np.array(value, np.float64)
    raise InputError(f"{owner}: {key} is {shortened(value)}; give three numbers")
