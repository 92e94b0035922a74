"""TOML files into protocols: every key is known, every value has the right type, or one sentence says what is wrong."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

from handbench.bench.protocol import (
    AGGREGATION,
    AXES,
    Column,
    ColumnLight,
    Enrolment,
    PerIdentity,
    Protocol,
    Published,
    Selection,
)
from handbench.errors import InputError, shortened, unknown_name
from handbench.files import check_value
from handbench.recording import PARTS
from handbench.scene import check_frame_kind
from handbench.terminal import printable
from handbench.tomlfile import read_toml

T = TypeVar("T")

_SELECTION = ("segments", "kinds", "lightings", "poses", "cameras")
_ENROL = ("count", "gives", "per_identity", *_SELECTION)
_COLUMN = ("name", "title", "subjects", "shares", "limit", "light", "maps", *_SELECTION)
_TOP = (
    *("name", "version", "title", "summary", "capture", "size", "subjects", "train", "enrol", "column"),
    *("metrics", "methods", "seeds", "preset", "presets", "aggregation", "sample_seed", "published", "published_note"),
)
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")  # a run folder has it, so it is no path
_CAPTURE = ("capture", "size")
_PUBLISHED = ("method", "title", "marker", "source", "values")


def load(path: Path) -> Protocol:
    """The protocol in a TOML file. Raises `InputError` for an unreadable file or a value that cannot be used."""
    return parse(read_toml(path, "protocol file"), str(path))


def parse(table: Mapping[str, Any], origin: str) -> Protocol:
    """A protocol from a parsed TOML table; `origin` names it in errors."""
    check_value(table, f"protocol {origin}")
    top = _Reader(f"protocol {origin}", table, _TOP)
    groups = _Reader(f"{top.owner} [subjects]", top.table("subjects"), ("trained", "unseen"))
    trained = groups.texts("trained")
    unseen = groups.texts("unseen", default=()) if groups.given.get("unseen") != [] else ()
    if both := set(trained) & set(unseen):
        raise InputError(f"{groups.owner}: {sorted(both)[0]!r} is both trained and unseen; keep it in one list")
    columns = top.get("column", list, "[[column]] tables")
    if not columns:
        raise InputError(f"{top.owner}: there is no [[column]]; add one, nothing would be scored")
    named = tuple(_column(f"{top.owner} column {i + 1}", column, trained, unseen) for i, column in enumerate(columns))
    _distinct(top.owner, "column name", [column.name for column in named])
    train = top.table("train")
    trains_on = _trains_on(f"{top.owner} [train]", train)
    if trains_on is not None:
        _only_unseen(top.owner, named, trained)
    presets = _Reader(f"{top.owner} [presets]", top.table("presets", default={}), None)
    metrics = top.texts("metrics")
    published = top.get("published", list, "[[published]] tables", [])
    return Protocol(
        name=top.name("name"),
        version=top.whole("version", least=1),
        title=top.text("title"),
        summary=top.text("summary"),
        capture=top.text("capture"),
        size=top.text("size"),
        trained=trained,
        unseen=unseen,
        train=_selection(f"{top.owner} [train]", _selecting(train)),
        enrol=_enrolment(f"{top.owner} [enrol]", top.table("enrol")),
        columns=named,
        metrics=metrics,
        methods=top.texts("methods"),
        aggregation=_aggregation(top),
        seeds=top.wholes("seeds", default=(0,)),
        preset=top.text("preset", default="quick"),
        presets=tuple((method, presets.text(method)) for method in sorted(presets.given)),
        sample_seed=top.whole("sample_seed", least=0, default=0),
        published=tuple(
            _published(f"{top.owner} published {i + 1}", row, [column.name for column in named], metrics)
            for i, row in enumerate(published)
        ),
        published_note=top.text("published_note", default="", empty=True),
        trains_on=trains_on,
    )


def _selecting(table: Mapping[str, Any]) -> dict[str, Any]:
    """A [train] table without the capture it is of."""
    return {key: value for key, value in table.items() if key not in _CAPTURE}


def _trains_on(owner: str, table: Mapping[str, Any]) -> tuple[str, str] | None:
    """Name and size of the capture that a [train] table names, None for the protocol's own."""
    given = {key: value for key, value in table.items() if key in _CAPTURE}
    if not given:
        return None
    reader = _Reader(owner, given, _CAPTURE)
    return reader.text("capture"), reader.text("size")


def _only_unseen(owner: str, columns: Iterable[Column], trained: tuple[str, ...]) -> None:
    for column in columns:
        names = trained if column.subjects == "trained" else column.subjects
        if not set(trained).isdisjoint(() if names == "unseen" else names):
            raise InputError(
                f"{owner}: column {column.name!r} scores trained subjects, who are in the capture of [train]; "
                "score unseen ones"
            )


def _column(owner: str, table: Any, trained: tuple[str, ...], unseen: tuple[str, ...]) -> Column:
    reader = _Reader(owner, table, _COLUMN)
    name = reader.text("name")
    reader.owner = f"{owner} ({name})"
    subjects = _subjects(reader, trained, unseen)
    shares = reader.texts("shares", default=())
    for axis in shares:
        if axis not in AXES:
            raise unknown_name(f"axis in the shares of {reader.owner}:", axis, AXES)
    selection = _selection(reader.owner, {key: reader.given[key] for key in _SELECTION if key in reader.given})
    limit = reader.whole("limit", least=1) if "limit" in reader.given else None
    light = reader.choice("light", reader.text("light", default="given"), get_args(ColumnLight))
    maps = reader.texts("maps", default=())
    if maps and light != "given":
        raise InputError(f"{reader.owner}: maps are lights that are given; leave out light, or maps")
    return Column(name, reader.text("title"), subjects, selection, shares, limit, light, maps)


def _subjects(column: _Reader, trained: tuple[str, ...], unseen: tuple[str, ...]) -> str | tuple[str, ...]:
    """ "trained", "unseen", or names that are all in one of these groups: a column answers one question."""
    if isinstance(column.given.get("subjects"), list):
        names = column.texts("subjects")
        for name in names:
            if name not in trained + unseen:
                raise unknown_name(f"subject in {column.owner}:", name, trained + unseen)
        if set(names) & set(trained) and set(names) & set(unseen):
            raise InputError(
                f"{column.owner}: subjects {shortened(list(names))} are of both groups; name trained or unseen ones"
            )
        return names
    group = column.text("subjects")
    if group not in ("trained", "unseen"):
        raise InputError(
            f'{column.owner}: subjects is {shortened(group)}; write "trained", "unseen" or a list of names'
        )
    if group == "unseen" and not unseen:
        raise InputError(f'{column.owner}: subjects is "unseen", but [subjects] lists no unseen subject; add one')
    return group


def _published(owner: str, table: Any, columns: Sequence[str], metrics: Sequence[str]) -> Published:
    reader = _Reader(owner, table, _PUBLISHED)
    method = reader.text("method")
    owner = f"{owner} ({method})"
    values: list[tuple[str, str, float]] = []
    for column, of_column in _Reader(f"{owner} values", reader.table("values"), columns).given.items():
        scores = _Reader(f"{owner} values of {column}", of_column, metrics)
        for metric in scores.given:
            value = scores.get(metric, (int, float), "a number")
            if not math.isfinite(value):
                raise InputError(f"{scores.owner}: {metric} is {value}; leave out what is not published")
            values.append((column, metric, float(value)))
    if not values:
        raise InputError(f"{owner}: values is empty; give a number or remove the row")
    marker = reader.text("marker", default="", empty=True)
    return Published(method, reader.text("title"), marker, reader.text("source"), tuple(values))


def _selection(owner: str, table: Mapping[str, Any]) -> Selection:
    reader = _Reader(owner, table, _SELECTION)
    for kind in reader.texts("kinds", default=()):
        check_frame_kind(owner, kind)
    return Selection(**{key: reader.texts(key) for key in reader.given})


def _enrolment(owner: str, table: Mapping[str, Any]) -> Enrolment:
    reader = _Reader(owner, table, _ENROL)
    selection = _selection(owner, {key: reader.given[key] for key in _SELECTION if key in reader.given})
    count = reader.whole("count", least=1) if "count" in reader.given else None
    gives = frozenset(reader.choice("gives", part, PARTS) for part in reader.texts("gives", default=tuple(PARTS)))
    if "image" not in gives:
        raise InputError(f'{owner}: gives is without "image"; add it, enrolment shows pictures')
    per_identity = reader.choice("per_identity", reader.text("per_identity", default="train"), get_args(PerIdentity))
    return Enrolment(selection, count, gives, per_identity)


def _aggregation(top: _Reader) -> tuple[str, ...]:
    steps = top.texts("aggregation")
    if steps != AGGREGATION:
        raise InputError(
            f"{top.owner}: aggregation is {shortened(list(steps))}; reports average in the order {list(AGGREGATION)}"
        )
    return steps


def _distinct(owner: str, what: str, values: Iterable[Any]) -> None:
    seen = set()
    for value in values:
        if value in seen:
            raise InputError(f"{owner}: {what} {shortened(value)} is given twice; keep one")
        seen.add(value)


class _Reader:
    """A table whose keys are known and whose values are read with their type checked; `known` None allows any key."""

    def __init__(self, owner: str, table: Any, known: Sequence[str] | None) -> None:
        self.owner = owner
        if not isinstance(table, Mapping):
            raise InputError(f"{owner}: expected a table, got {shortened(table)}")
        self.given = table
        for key in table:
            if known is not None and key not in known:
                raise unknown_name(f"key in {owner}:", key, known)
            if not _one_line(key):
                raise InputError(f"{owner}: key {shortened(key)} is no line without control characters; rename it")

    def get(self, key: str, kind: type | tuple[type, ...], wanted: str, default: Any = None) -> Any:
        value = self.given.get(key, default)
        if value is None:
            raise InputError(f"{self.owner}: {key!r} is missing; give {wanted}")
        if not isinstance(value, kind) or isinstance(value, bool):
            raise InputError(f"{self.owner}: {key} is {shortened(value)}; give {wanted}")
        return value

    def table(self, key: str, default: Mapping[str, Any] | None = None) -> Mapping[str, Any]:
        return self.get(key, dict, f"a [{key}] table", default)

    def text(self, key: str, default: str | None = None, empty: bool = False) -> str:
        value = self.get(key, str, "a text", default)
        if not value.strip() and not empty:
            raise InputError(f"{self.owner}: {key} is empty; give a text")
        if not _one_line(value):
            raise InputError(f"{self.owner}: {key} is {shortened(value)}; give one line without control characters")
        return value

    def name(self, key: str) -> str:
        value = self.text(key)
        if not _NAME.fullmatch(value):
            raise InputError(
                f"{self.owner}: {key} is {shortened(value)}; use up to 64 letters, digits, points, dashes, underscores"
            )
        return value

    def choice(self, key: str, value: str, known: Iterable[T]) -> T:
        """The one of the known words that a value is. Raises `InputError` for any other, with those close to it."""
        named = {str(word): word for word in known}
        if value not in named:
            raise unknown_name(f"{key} in {self.owner}:", value, named)
        return named[value]

    def whole(self, key: str, least: int, default: int | None = None) -> int:
        value = self.get(key, int, f"a whole number, at least {least}", default)
        if value < least:
            raise InputError(f"{self.owner}: {key} is {value}; give a whole number, at least {least}")
        return value

    def texts(self, key: str, default: tuple[str, ...] | None = None) -> tuple[str, ...]:
        def fits(item: Any) -> bool:
            return isinstance(item, str) and bool(item.strip()) and _one_line(item)

        return self._list(key, "a list of texts", fits, default)

    def wholes(self, key: str, default: tuple[int, ...] | None = None) -> tuple[int, ...]:
        return self._list(
            key, "a list of whole numbers, at least 0", lambda item: type(item) is int and item >= 0, default
        )

    def _list(
        self, key: str, wanted: str, fits: Callable[[Any], bool], default: tuple[Any, ...] | None
    ) -> tuple[Any, ...]:
        if key not in self.given and default is not None:
            return default
        values = self.get(key, list, wanted)
        if not values or not all(map(fits, values)):
            raise InputError(f"{self.owner}: {key} is {shortened(values)}; give {wanted}, not empty")
        _distinct(self.owner, f"entry of {key}", values)
        return tuple(values)


def _one_line(text: str) -> bool:
    return printable(text) == text and not set("\n\t") & set(text)
