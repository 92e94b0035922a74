"""Settings of a method as a command line gives them: `steps=500`, read as the type that its configuration declares.

A factory that takes `changes` beside its preset can be set this way: it passes them to `changed` (or, if it is made of
several configurations, first to `parted`). Names are fields; a field of a configuration inside another has a point in
its name (`weights.photometric`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from types import MappingProxyType, NoneType, UnionType
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar, Union, get_args, get_origin, get_type_hints

from .errors import InputError, shortened, unknown_name

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    _Config = TypeVar("_Config", bound=DataclassInstance)

Changes: TypeAlias = Mapping[str, str]
"""Texts by the names of settings."""

UNCHANGED: Changes = MappingProxyType({})

_NONE = "none"
_TRUTH = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}


@dataclass(frozen=True)
class Setting:
    """One change: a setting's name, its value as text, and the methods it is for, a pattern; "" is all that have it."""

    name: str
    value: str
    methods: str = ""

    @classmethod
    def parse(cls, text: str) -> Setting:
        """ "steps=500" or "urhand*:steps=500". Raises `InputError` for anything else."""
        name, equals, value = text.partition("=")
        methods, colon, of_methods = name.rpartition(":")
        name = of_methods.strip()
        if not equals or not name or (colon and not methods.strip()):
            raise InputError(f"setting {shortened(text)} cannot be read; write steps=500, or urhand:steps=500")
        return cls(name, value.strip(), methods.strip())


def changed(config: _Config, changes: Changes, owner: str) -> _Config:
    """A configuration, a dataclass, with other values; `owner` names it in errors.

    Values are numbers, true or false, words, lists with commas (`rate=1e-3,1e-4`) and none where that is allowed.
    Raises `InputError` for a name that is no field, with the closest names, for a text of another type, and whatever
    the configuration itself refuses.
    """
    for name, text in changes.items():
        config = _with(config, name.split("."), text, name, owner)
    return config


def parted(changes: Changes, parts: Sequence[str], owner: str) -> tuple[dict[str, str], ...]:
    """The changes of each part of a configuration, without the part's name before them.

    Raises `InputError` for a name of no part.
    """
    found: dict[str, dict[str, str]] = {part: {} for part in parts}
    for name, text in changes.items():
        part, point, rest = name.partition(".")
        if part not in found or not point:
            raise unknown_name(f"setting of {owner}:", name, [f"{part}.…" for part in parts])
        found[part][rest] = text
    return tuple(found.values())


def names_in(config: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """The settings of a method's `config` by name, with their values."""
    for name, value in config.items():
        if isinstance(value, Mapping):
            yield from names_in(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", value


def _with(config: Any, path: Sequence[str], text: str, name: str, owner: str) -> Any:
    first, *rest = path
    inner = getattr(config, first, None)
    if rest and is_dataclass(inner):
        return replace(config, **{first: _with(inner, rest, text, name, owner)})
    above = name.removesuffix(".".join(path))
    if rest or is_dataclass(inner) or first not in (field.name for field in fields(config)):
        known = inner if is_dataclass(inner) else config
        within = f"{above}{first}." if is_dataclass(inner) else above
        raise unknown_name(f"setting of {owner}:", name, [f"{within}{field.name}" for field in fields(known)])
    kind = get_type_hints(type(config))[first]
    found = _read(kind, text)
    if found is _UNFIT:
        raise InputError(f"{owner}: {name} is {shortened(text)}; give {_wanted(kind)}")
    return replace(config, **{first: found})


class _Unfit:
    """A text that is no value of its type."""


_UNFIT = _Unfit()


def _read(kind: Any, text: str) -> Any:
    """A text as a value of a type; every number is finite and none is negative, which no setting may be."""
    if kind is bool:
        return _TRUTH.get(text.lower(), _UNFIT)
    if kind is str:
        return text
    if kind in (int, float):
        return _number(kind, text)
    match get_origin(kind):
        case origin if origin is Literal:
            return next((word for word in get_args(kind) if str(word) == text), _UNFIT)
        case origin if origin in (Union, UnionType):
            read = (_read(each, text) for each in get_args(kind) if each is not NoneType)
            if text.lower() == _NONE and NoneType in get_args(kind):
                return None
            return next((value for value in read if value is not _UNFIT), _UNFIT)
        case origin if origin is tuple:
            return _list(get_args(kind), text)
    return _UNFIT


def _number(kind: type[int] | type[float], text: str) -> Any:
    try:
        value = kind(text) if len(text) <= 30 else math.nan
    except ValueError:
        return _UNFIT
    return value if math.isfinite(value) and value >= 0 else _UNFIT


def _list(kinds: tuple[Any, ...], text: str) -> Any:
    texts = [each.strip() for each in text.strip("[]()").split(",") if each.strip()]
    if kinds[-1:] == (...,):
        kinds = kinds[:1] * len(texts)
    if not texts or len(texts) != len(kinds):
        return _UNFIT
    values = tuple(_read(kind, each) for kind, each in zip(kinds, texts, strict=True))
    return _UNFIT if _UNFIT in values else values


def _wanted(kind: Any) -> str:
    """What a type takes, in words."""
    if kind is bool:
        return "true or false"
    if kind is str:
        return "a text"
    if kind is int:
        return "a whole number, 0 or more"
    if kind is float:
        return "a number, 0 or more"
    match get_origin(kind):
        case origin if origin is Literal:
            return " or ".join(map(str, get_args(kind)))
        case origin if origin in (Union, UnionType):
            return " or ".join(_NONE if each is NoneType else _wanted(each) for each in get_args(kind))
        case origin if origin is tuple:
            inner = get_args(kind)
            count = "" if inner[-1:] == (...,) else f"{len(inner)} "
            return f"{count}values with commas between them, each {_wanted(inner[0])}"
    return "a value that can be written as text; this one cannot be set"
