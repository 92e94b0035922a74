"""handbench.toml: what a plain folder holds and how it is meant. Every key is known, every value is looked at."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, shortened, unknown_name
from ...hand.known import SHIPPED
from ...tomlfile import read_toml
from .pattern import FIELDS, Pattern, check_name, check_path

FILE = "handbench.toml"
FORMAT, VERSION = "handbench folder", 1
UNITS = {"metres": 1.0, "centimetres": 0.01, "millimetres": 0.001}
COLOURS = ("srgb", "linear")
HANDS = (SHIPPED, "mano-right", "mano-left")
MODEL = "from poses"
"""Said of meshes: they are the hand model's, posed."""

UP: dict[str, tuple[tuple[int, int, int], ...]] = {
    "y": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "z": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "-y": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
}
"""Rotations from a folder's world, by the axis that is up in it, to ours, in which +y is."""

_CONSTANTS = {"subject": "me", "segment": "all", "pose": "still", "camera": "camera", "lighting": "room"}
_PARTS = ("masks", "keypoints", "depth", "meshes", "poses")
_KEYS = (
    *("format", "version", "name", "hand", "flat_hand_mean", "units", "up", "images", "colour", "sequence"),
    *("depth_unit", "cameras", "light", *FIELDS, *_PARTS),
)
_CAMERAS = ("file", "colmap", "field_of_view")


@dataclass(frozen=True)
class FolderManifest:
    """What handbench.toml says, in its order; `unit` in metres, `up` (3, 3) turns the folder's world into ours."""

    name: str
    hand: str | None
    flat_hand_mean: bool | None
    unit: float
    up: Any
    images: Pattern
    colour: str
    constants: dict[str, str]
    sequence: bool
    parts: dict[str, Pattern]
    model_meshes: bool
    depth_unit: float
    cameras: dict[str, Any]
    lights: tuple[dict[str, Any], ...]


def read_manifest(path: Path) -> FolderManifest:
    """The manifest of a folder. Raises `InputError` for the first thing in it that cannot be used."""
    table, owner = read_toml(path, "folder file"), str(path)
    if table.get("format") != FORMAT or table.get("version") != VERSION:
        raise InputError(f'{owner} must begin with format = "{FORMAT}" and version = {VERSION}')
    _known(owner, table, _KEYS)
    hand = _choice(owner, table, "hand", HANDS, None)
    flat = table.get("flat_hand_mean")
    if flat is not None and not isinstance(flat, bool):
        raise InputError(f"{owner}: flat_hand_mean is {shortened(flat)}; say true or false")
    images = _pattern(owner, table, "images")
    if images is None:
        raise InputError(f'{owner}: images is missing; say where pictures are, as in images = "images/{{pose}}.png"')
    model_meshes = table.get("meshes") == MODEL
    parts = {
        name: pattern
        for name in _PARTS
        if not (name == "meshes" and model_meshes) and (pattern := _pattern(owner, table, name)) is not None
    }
    _consistent(owner, table, images, parts, hand, model_meshes)
    name = table.get("name", path.parent.resolve().name)
    return FolderManifest(
        name=check_name(f"{owner}: name", name),
        hand=hand,
        flat_hand_mean=flat,
        unit=UNITS[_choice(owner, table, "units", tuple(UNITS), "metres") or "metres"],
        up=np.array(UP[_choice(owner, table, "up", tuple(UP), "y") or "y"], np.float64),
        images=images,
        colour=_choice(owner, table, "colour", COLOURS, "srgb") or "srgb",
        constants={
            field: check_name(f"{owner}: {field}", table.get(field, usual)) for field, usual in _CONSTANTS.items()
        },
        sequence=_flag(owner, table, "sequence"),
        parts=parts,
        model_meshes=model_meshes,
        depth_unit=_positive(owner, "depth_unit", table.get("depth_unit", 0.001)),
        cameras=_cameras(owner, table.get("cameras", {})),
        lights=tuple(_tables(owner, table.get("light", []))),
    )


def _consistent(
    owner: str,
    table: dict[str, Any],
    images: Pattern,
    parts: dict[str, Pattern],
    hand: str | None,
    model_meshes: bool,
) -> None:
    """What one key says of another."""
    for field in images.fields:
        if field in table:
            raise InputError(f"{owner}: {field} is given, and read from images too; leave one of the two out")
    for name, pattern in parts.items():
        if strange := [field for field in pattern.fields if field not in images.fields]:
            raise InputError(f"{owner}: {name} has {{{strange[0]}}}, which images does not have; put it there too")
    for name in ("meshes", "poses"):
        if name in parts and (odd := set(parts[name].fields) & {"camera", "lighting"}):
            raise InputError(f"{owner}: {name} has {{{min(odd)}}}, but a pose has one for all cameras and lights")
    if "poses" in parts and hand is None:
        raise InputError(f"{owner}: poses are given, but not of which hand model; say hand = {' | '.join(HANDS)}")
    if model_meshes and "poses" not in parts:
        raise InputError(f'{owner}: meshes are said to be "{MODEL}", but there are no poses; give poses')
    if "flat_hand_mean" in table and (hand is None or hand == SHIPPED):
        raise InputError(f"{owner}: flat_hand_mean is of MANO's poses, and hand is {hand!r}; leave it out")


def _cameras(owner: str, given: Any) -> dict[str, Any]:
    if not isinstance(given, dict):
        raise InputError(f"{owner}: cameras is {shortened(given)}; write a table [cameras]")
    _known(f"{owner} [cameras]", given, _CAMERAS)
    if len(given) > 1:
        raise InputError(f"{owner} [cameras]: {' and '.join(given)} are given; keep one of them")
    for name in ("file", "colmap"):
        if name in given:
            check_path(f"{owner} [cameras]: {name}", given[name])
    if "field_of_view" in given:
        angle = _positive(f"{owner} [cameras]", "field_of_view", given["field_of_view"])
        if angle >= 170:
            raise InputError(f"{owner} [cameras]: field_of_view is {angle:g} degrees; give less than 170")
    return given


def _tables(owner: str, given: Any) -> Iterable[dict[str, Any]]:
    if not isinstance(given, list) or not all(isinstance(light, dict) for light in given):
        raise InputError(f"{owner}: light is {shortened(given)}; write tables [[light]]")
    for light in given:
        _known(f"{owner} [[light]]", light, ("name", "environment", "direction", "irradiance", "position", "intensity"))
        yield light


def _pattern(owner: str, table: dict[str, Any], key: str) -> Pattern | None:
    return None if key not in table else Pattern.parse(f"{owner}: {key}", table[key])


def _known(owner: str, table: dict[str, Any], keys: tuple[str, ...]) -> None:
    for key in table:
        if key not in keys:
            raise unknown_name(f"key of {owner}:", key, keys)


def _choice(owner: str, table: dict[str, Any], key: str, choices: tuple[str, ...], usual: str | None) -> str | None:
    value = table.get(key, usual)
    if value is None or (isinstance(value, str) and value in choices):
        return value
    raise InputError(f"{owner}: {key} is {shortened(value)}; use one of {', '.join(choices)}")


def _flag(owner: str, table: dict[str, Any], key: str) -> bool:
    value = table.get(key, False)
    if not isinstance(value, bool):
        raise InputError(f"{owner}: {key} is {shortened(value)}; say true or false")
    return value


def _positive(owner: str, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < 1e9:
        raise InputError(f"{owner}: {key} is {shortened(value)}; give a number above 0")
    return float(value)
