"""capture.json: what a reader needs beside the pictures, checked when it is read; `describe` says what is in it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, TypeAlias

from ...cache import cache_folder
from ...errors import InputError
from ...files import JSON_LIMIT, read_text
from .presets import GENERATOR_VERSION, SCHEMA, recipe

Manifest: TypeAlias = dict[str, Any]

FILE = "capture.json"
_WIDEST = 1 << 15  # pixels a side of a picture


def command(capture: str, size: str, place: Path) -> str:
    """What makes a capture in its folder `place`."""
    folder = "" if place.parent == cache_folder() else f" --folder {place.parent}"
    return f"handbench data make {capture} --size {size}{folder}"


def read_manifest(path: Path) -> Manifest:
    """The values of a capture.json.

    Raises `InputError` for one that is damaged, was edited, or is of another schema or generator.
    """
    try:
        found = json.loads(read_text(path, JSON_LIMIT, "capture"))
        schema, generator = found["schema"], found["generator"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{path} cannot be read ({error}); delete it and make the capture again") from error
    if schema != SCHEMA:
        raise InputError(f"{path} has schema {schema}, this version reads {SCHEMA}; make the capture again")
    try:
        remedy = f"delete it and make it again: {command(found['capture'], found['preset']['name'], path.parent)}"
        if generator != GENERATOR_VERSION:
            raise InputError(
                f"{path.parent} was made by generator {generator}, this version has {GENERATOR_VERSION}; {remedy}"
            )
        _check(found)
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        wrong = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else error
        raise InputError(f"{path} is damaged ({wrong}); delete it and make the capture again") from error
    if found["recipe"] != recipe(found["capture"], generator, found["preset"]):
        raise InputError(f"the preset of {path.parent} was edited: it is not the one of its recipe; {remedy}")
    return found


def _check(found: Manifest) -> None:
    """Raise `KeyError`, `TypeError` or `ValueError` for a manifest that no generator writes, before it is followed."""
    for kind in ("cameras", "lightings", "subjects"):
        if not isinstance(found[kind], list) or not found[kind]:
            raise ValueError(f"it has no {kind}")
    for camera in found["cameras"]:
        size = camera["width"], camera["height"]
        if any(type(side) is not int or not 0 < side <= _WIDEST for side in size):
            raise ValueError(f"camera {camera['name']!r} has {size[0]} x {size[1]} pixels, at most {_WIDEST} a side")
    for lighting in found["lightings"]:
        if lighting["weights"] is not None and len(lighting["weights"]) != len(found["olat"]):
            raise ValueError(f"lighting {lighting['name']!r} has {len(lighting['weights'])} weights for its lights")
    poses = [pose for person in found["subjects"] for pose in person["poses"]]
    for kind in ("cameras", "lightings", "subjects"):
        _check_names(kind, found[kind])
    _check_names("poses", poses)
    known = {kind: {entry["name"] for entry in found[kind]} for kind in ("cameras", "lightings")}
    for shot in (shot for pose in poses for shot in pose["shots"]):
        for kind, names in known.items():
            if strange := set(shot[kind] or ()) - names:
                raise ValueError(f"a shot has {strange.pop()!r}, which is none of its {kind}")


def _check_names(kind: str, entries: list[dict[str, Any]]) -> None:
    """Names become parts of paths, so they are words, and nothing else."""
    for entry in entries:
        if not isinstance(entry["name"], str) or not re.fullmatch(r"\w[\w.-]*", entry["name"]):
            raise ValueError(f"{entry['name']!r} cannot be the name of one of its {kind}")
