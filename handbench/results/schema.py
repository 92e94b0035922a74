"""Records: frozen dataclasses whose fields say what they hold, read from JSON with every value checked.

A field is declared once, `name: type = told("what it is")`; reading, writing, SQL types and documentation follow from
it. Types are str, int (64 bits), float (finite), bool, None, Literal, X | Y, tuple[X, ...], dict[str, X], other
records, `Json` (any JSON value), and Annotated with a `Rule` on values. A field with a default may be missing.
"""

from __future__ import annotations

import json
import math
import types
from collections.abc import Callable
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, TypeAlias, TypeVar, Union, get_args, get_origin, get_type_hints

from ..files import check_value

Json: TypeAlias = object
"""Any JSON value, kept as it is."""

_Record = TypeVar("_Record")
_Reader = Callable[[Any], Any]
_LARGEST = 2**63


class Misfit(ValueError):
    """A value that does not fit its field: `place` is the way to it, `told` what is wrong."""

    def __init__(self, told: str, place: str = "") -> None:
        super().__init__(told)
        self.told, self.place = told, place

    def within(self, outer: str | int) -> Misfit:
        """The same, seen from one level further out."""
        head = f"[{outer}]" if isinstance(outer, int) else outer
        joint = "" if not self.place or self.place.startswith("[") else "."
        return Misfit(self.told, f"{head}{joint}{self.place}")

    def __str__(self) -> str:
        return f"{self.place or 'it'} {self.told}"


@dataclass(frozen=True)
class Rule:
    """What values of a field must be beyond their type; `told` ends the sentence "… is X, not …"."""

    told: str
    holds: Callable[[Any], bool]


def told(text: str, **default: Any) -> Any:
    """A field with its description; `default` or `default_factory` for one that may be missing."""
    return field(metadata={"told": text}, **default)


def read(kind: Callable[..., _Record], value: object) -> _Record:
    """A record, or a value of any type of a field, from a JSON value. Raises `Misfit`."""
    found: _Record = reader(kind)(value)
    return found


def plain(value: Any) -> Any:
    """A record as a JSON value."""
    if is_dataclass(value):
        return {each.name: plain(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return value


def reader(hint: Any) -> _Reader:
    """The function that reads a value of a type."""
    return _made(hint)


@cache
def _made(hint: Any) -> _Reader:
    origin, arguments = get_origin(hint), get_args(hint)
    if hint in _SIMPLE:
        return _SIMPLE[hint]
    if is_dataclass(hint):
        return _record(hint)
    if origin is Annotated:
        return _ruled(reader(arguments[0]), arguments[1])
    if origin is Literal:
        return _ruled(lambda value: value, Rule(f"one of {', '.join(map(repr, arguments))}", _among(arguments)))
    if origin in (Union, types.UnionType):
        return _union(arguments)
    if origin is tuple and len(arguments) == 2 and arguments[1] is Ellipsis:
        return _list(reader(arguments[0]))
    if origin is dict:
        return _dict(*map(reader, arguments))
    raise TypeError(f"no JSON value is read as {hint}")


def shown(value: object) -> str:
    """A value in a sentence, cut where it is long."""
    try:
        text = json.dumps(value)
    except (TypeError, ValueError):
        text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _wrong(value: object, wanted: str) -> Misfit:
    return Misfit(f"is {shown(value)}, not {wanted}")


def _text(value: Any) -> str:
    if type(value) is not str:
        raise _wrong(value, "a text")
    if not value.isascii() and any("\ud800" <= letter <= "\udfff" for letter in value):
        raise _wrong(value, "a text of whole characters")
    return value


def _int(value: Any) -> int:
    if type(value) is not int:
        raise _wrong(value, "a whole number")
    if not -_LARGEST <= value < _LARGEST:
        raise Misfit("is a whole number beyond 64 bits")
    return value


def _float(value: Any) -> float:
    if type(value) is not float:
        if type(value) is not int:
            raise _wrong(value, "a number")
        value = float(value) if -_LARGEST <= value < _LARGEST else math.inf
    if not math.isfinite(value):
        raise Misfit("is not a finite number")
    return value


def _bool(value: Any) -> bool:
    if type(value) is not bool:
        raise _wrong(value, "true or false")
    return value


def _none(value: Any) -> None:
    if value is not None:
        raise _wrong(value, "null")


def _json(value: Any) -> Any:
    try:
        check_value(value, "")
        json.dumps(value, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise Misfit(f"cannot be kept ({str(error).lstrip(': ')})") from None
    return value


_SIMPLE: dict[Any, _Reader] = {str: _text, int: _int, float: _float, bool: _bool, type(None): _none, Json: _json}


def _among(values: tuple[Any, ...]) -> Callable[[Any], bool]:
    return lambda value: any(type(value) is type(each) and value == each for each in values)


def _ruled(inner: _Reader, rule: Rule) -> _Reader:
    holds = rule.holds

    def read(value: Any) -> Any:
        found = inner(value)
        if not holds(found):
            raise _wrong(value, rule.told)
        return found

    return read


def _union(hints: tuple[Any, ...]) -> _Reader:
    """`X | None` is told as X; of other unions the last one's complaint is."""
    optional = type(None) in hints
    readers = [reader(hint) for hint in hints if hint is not type(None)]
    if optional and len(readers) == 1:
        one = readers[0]
        return lambda value: None if value is None else one(value)

    def read(value: Any) -> Any:
        if value is None and optional:
            return None
        for attempt in readers[:-1]:
            try:
                return attempt(value)
            except Misfit:
                continue
        return readers[-1](value)

    return read


def _list(item: _Reader) -> _Reader:
    def read(value: Any) -> tuple[Any, ...]:
        if type(value) is not list:
            raise _wrong(value, "a list")
        try:
            return tuple(map(item, value))
        except Misfit:  # once more, to say where
            for place, each in enumerate(value):
                try:
                    item(each)
                except Misfit as misfit:
                    raise misfit.within(place) from None
            raise

    return read


def _dict(key: _Reader, item: _Reader) -> _Reader:
    def read(value: Any) -> dict[str, Any]:
        if type(value) is not dict:
            raise _wrong(value, "an object")
        found = {}
        for name, each in value.items():
            try:
                found[key(name)] = item(each)
            except Misfit as misfit:
                raise misfit.within(shown(name)) from None
        return found

    return read


def _record(kind: Any) -> _Reader:
    hints = get_type_hints(kind, include_extras=True)
    slots = [(each.name, reader(hints[each.name]), _required(each)) for each in fields(kind)]

    def read(value: Any) -> Any:
        if type(value) is not dict:
            raise _wrong(value, "an object")
        found = {}
        for name, of_field, required in slots:
            if name in value:
                try:
                    found[name] = of_field(value[name])
                except Misfit as misfit:
                    raise misfit.within(name) from None
            elif required:
                raise Misfit("is missing", name)
        return kind(**found)

    return read


def _required(each: Any) -> bool:
    return each.default is MISSING and each.default_factory is MISSING
