"""From a protocol, methods and seeds to cells, each with a key: equal keys, and a kept result is used again.

A key covers the versions of handbench, torch, jax and mitsuba, the method's source (see `source_digest`), its
preset, the seed, the digests of capture and protocol, the metrics' source, and the subject. It does not cover
other packages, the bench's own code within one version, or the machine; those are told in a cell's provenance.
Nothing heavy is imported and no time is in it.
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Iterable
from dataclasses import dataclass

from .. import __version__
from ..errors import InputError
from ..registry import METHODS, METRICS
from .protocol import Protocol, digest
from .source import source_digest

_PACKAGES = ("torch", "jax", "mitsuba")  # whose releases change what methods and captures compute


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
    versions = [__version__, *map(_version, _PACKAGES)]
    cells = []
    for name, entry in entries.items():
        chosen = preset or protocol.preset_of(name)
        code = source_digest(entry.target)
        for seed in seeds:
            prior = digest(
                [versions, name, entry.settings, chosen, code, seed, capture_digest, protocol.training_digest]
            )
            for subject in protocol.subjects:
                key = digest([prior, protocol.digest, scoring, subject])
                cells.append(Cell(key, prior, name, chosen, subject, seed))
    return Plan(protocol, capture_digest, methods, seeds, tuple(cells))


def _version(package: str) -> str | None:
    """The version of an installed package, found without importing it."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
