"""From a protocol, methods and seeds to cells, each with a key that names everything that decides its result.

A key covers what is given (preset, protocol, data, seed) and the code that acts on it (method, metrics, the
package's version), so the resolved configuration follows from it. Nothing heavy is imported and no time is in it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from .. import __version__
from ..errors import InputError
from ..registry import METHODS, METRICS
from .protocol import Protocol, digest
from .source import source_digest


@dataclass(frozen=True)
class Cell:
    """One method on one subject with one seed. Cells of equal `prior` share a training."""

    key: str
    prior: str
    method: str
    preset: str
    subject: str
    seed: int


@dataclass(frozen=True)
class Plan:
    protocol: Protocol
    capture_digest: str
    methods: tuple[str, ...]
    seeds: tuple[int, ...]
    cells: tuple[Cell, ...]


def make_plan(
    protocol: Protocol,
    capture_digest: str,
    methods: Iterable[str] | None = None,
    seeds: Iterable[int] | None = None,
    preset: str | None = None,
) -> Plan:
    """All cells of a run, those that share a training side by side; None takes the protocol's default.

    Raises `InputError` for an unknown method or metric and for an empty list.
    """
    methods = tuple(dict.fromkeys(protocol.methods if methods is None else methods))
    seeds = tuple(dict.fromkeys(protocol.seeds if seeds is None else seeds))
    if not methods or not seeds:
        raise InputError("nothing to run: name at least one method and one seed")
    entries = {name: METHODS.entry(name) for name in methods}
    scoring = digest([source_digest(METRICS.entry(spec.partition(":")[0].strip()).target) for spec in protocol.metrics])
    cells = []
    for name, entry in entries.items():
        chosen = preset or protocol.preset_of(name)
        code = source_digest(entry.target)
        for seed in seeds:
            prior = digest([__version__, name, chosen, code, seed, capture_digest, protocol.training_digest])
            for subject in protocol.subjects:
                key = digest([prior, protocol.digest, scoring, subject])
                cells.append(Cell(key, prior, name, chosen, subject, seed))
    return Plan(protocol, capture_digest, methods, seeds, tuple(cells))
