"""From a protocol, methods and seeds to cells, each with a key: equal keys, and a kept result is used again.

What a cell's key covers, so that none of it can change behind a kept result:

    protocol    name, version, and everything in it that decides a score
    data        the capture's digest
    method      name, the source of its code and of what that imports, data files such as weights beside that
                (`source.py`), preset and settings as given, and the configuration they resolve to
    metrics     their source and data files
    cell        subject and seed
    versions    of handbench, torch, jax and mitsuba

The configuration of handbench's own methods is resolved by code and files that are covered, so they are not loaded
for it; a plug-in from outside may read its configuration anywhere, so it is made and asked. Not covered, and told in
a cell's provenance: other packages, the bench's own code within one version, the device, the machine. No time is in
a key, and no place on disk unless a setting names one. A prior's key covers the same without metrics, enrolment,
scored frames and subject; the key of a cell's pictures all but metrics and the protocol's name and version.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from .. import __version__
from ..errors import HandbenchError, InputError, text_of
from ..installed import version
from ..method import Method
from ..metricspec import MetricSpec
from ..registry import METHODS, METRICS, Entry
from ..source import source_digests
from .given import refusal
from .isolation import isolated
from .protocol import Protocol, digest
from .resolving import Selected

ChangesOf: TypeAlias = tuple[tuple[str, tuple[tuple[str, str], ...]], ...]
"""The changed settings of methods, by their names."""

_PACKAGES = ("torch", "jax", "mitsuba")  # whose releases change what methods and captures compute


@dataclass(frozen=True)
class Cell:
    """One method on one subject with one seed, with the settings that were changed. Cells of equal `prior` share a
    training, cells of equal `drawing` their pictures: they differ in metrics alone."""

    key: str
    prior: str
    method: str
    preset: str
    subject: str
    seed: int
    changes: tuple[tuple[str, str], ...] = ()
    drawing: str = ""

    @property
    def label(self) -> str:
        return f"{self.method} {self.subject} seed {self.seed}"


@dataclass(frozen=True)
class Plan:
    protocol: Protocol
    capture_digest: str
    methods: tuple[str, ...]
    seeds: tuple[int, ...]
    cells: tuple[Cell, ...]


def by_prior(cells: Iterable[Cell]) -> list[tuple[Cell, ...]]:
    """Cells that share a training, together, in the order of their first cell."""
    groups: dict[str, list[Cell]] = {}
    for cell in cells:
        groups.setdefault(cell.prior, []).append(cell)
    return [tuple(group) for group in groups.values()]


def method_entries(names: Iterable[str], extra: Sequence[Entry] = ()) -> dict[str, Entry]:
    """Plug-ins by name, registered ones and `extra`; `InputError` for an unknown name and for one that is taken."""
    known = {entry.name: entry for entry in extra}
    for name in known:
        if name in METHODS.entries():
            raise InputError(f"there is a method {name!r} already; choose another name")
    return {name: known.get(name) or METHODS.entry(name) for name in names}


def with_changes(entries: Mapping[str, Entry], changes: ChangesOf) -> dict[str, Entry]:
    """The plug-ins with changed settings."""
    of = dict(changes)
    return {name: replace(entry, changes=of.get(name, ())) for name, entry in entries.items()}


def check_preset(entries: Sequence[Entry], preset: str | None) -> None:
    """Raises `InputError` for a preset that is asked for where no method tells presets apart."""
    names = [entry.name for entry in entries if not entry.presets]
    if preset is not None and not any(entry.presets for entry in entries):
        raise InputError(f"there is no preset {preset!r}: {', '.join(names)} has none; leave the preset out")


def make_method(entry: Entry, preset: str) -> Method:
    """The method of a plug-in with a preset. Raises `InputError` for an unknown preset and for a broken plug-in."""
    try:
        with isolated(loading=True):
            method = entry.load()(preset=preset)
    except HandbenchError:
        raise
    except (Exception, SystemExit) as error:
        text = f"{type(error).__name__}: {text_of(error)}"
        raise InputError(f"plug-in {entry.name!r} at {entry.target!r} fails ({text}); mend it") from error
    if not isinstance(method, Method):
        made = type(method).__name__
        raise InputError(
            f"plug-in {entry.name!r} at {entry.target!r} makes a {made}, expected a handbench.method.Method"
        )
    return method


def make_plan(
    protocol: Protocol,
    capture_digest: str,
    methods: Iterable[str] | None = None,
    seeds: Iterable[int] | None = None,
    preset: str | None = None,
    extra: Sequence[Entry] = (),
    changes: ChangesOf = (),
) -> Plan:
    """All cells of a run, those that share a training side by side; None takes the protocol's default.

    `extra` are methods that are not registered; without `methods` they come after the protocol's. `changes` are the
    settings that are changed, by method.
    Raises `InputError` for an unknown method or metric, for a broken plug-in and for an empty list.
    """
    names = tuple(dict.fromkeys(default_methods(protocol, extra) if methods is None else methods))
    seeds = tuple(dict.fromkeys(protocol.seeds if seeds is None else seeds))
    if not names or not seeds:
        raise InputError("nothing to run: name at least one method and one seed")
    entries = with_changes(method_entries(names, extra), changes)
    metrics = [METRICS.entry(MetricSpec.parse(spec).name).target for spec in protocol.metrics]
    code = source_digests([*metrics, *(entry.target for entry in entries.values())])
    scoring = digest([code[target] for target in metrics])
    versions = [__version__, *map(version, _PACKAGES)]
    cells = []
    for name, entry in entries.items():
        chosen = preset or protocol.preset_of(name)
        made_of = [versions, name, entry.settings, chosen, code[entry.target], _resolved(entry, chosen)]
        for seed in seeds:
            prior = digest([*made_of, seed, capture_digest, protocol.training_digest])
            for subject in protocol.subjects:
                key = digest([prior, protocol.digest, scoring, subject])
                drawing = digest([prior, protocol.drawing_digest, subject])
                cells.append(Cell(key, prior, name, chosen, subject, seed, entry.changes, drawing))
    return Plan(protocol, capture_digest, names, seeds, tuple(cells))


def refusals(plan: Plan, selected: Selected, methods: Mapping[str, Method]) -> dict[str, str]:
    """Why cells cannot be tried, by their keys: what their methods need is not given. Nothing trains for them."""
    found = {cell.key: refusal(selected, methods[cell.method].info, cell.subject) for cell in plan.cells}
    return {key: reason for key, reason in found.items() if reason}


def default_methods(protocol: Protocol, extra: Sequence[Entry] = ()) -> tuple[str, ...]:
    return (*protocol.methods, *(entry.name for entry in extra))


def _resolved(entry: Entry, preset: str) -> Mapping[str, Any] | None:
    """The configuration of a plug-in from outside and of one whose settings are changed; our own are else resolved by
    what `source_digests` reads."""
    from .. import methods

    if entry.target.startswith("handbench.") and entry in methods.ENTRIES:
        return None
    config = make_method(entry, preset).config
    try:
        digest(config)
    except (TypeError, ValueError) as error:
        raise InputError(f"plug-in {entry.name!r} has a config that holds no JSON value: {text_of(error)}") from error
    return config
