"""The public function behind `handbench stress`."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...bench.progress import steps
from ...bench.provenance import provenance
from ...registry import METHODS
from .case import Case, Result
from .record import write_record
from .runner import run_cases
from .suite import select, source, suite


@dataclass(frozen=True)
class Stressed:
    """The results in the order of the suite, the seconds they took, and the file that holds them."""

    results: tuple[Result, ...]
    seconds: float
    path: Path

    @property
    def passed(self) -> bool:
        return all(result.passed for result in self.results)


def chosen_cases(methods: Sequence[str] | None = None, only: str | None = None) -> tuple[Case, ...]:
    """The suite over the named methods (None: all registered ones), or the cases of it that fit a glob.

    Raises `InputError` for an unknown method and for a glob that fits nothing.
    """
    for name in methods or ():
        METHODS.entry(name)
    return select(suite(methods), only)


def stress(
    out: Path, methods: Sequence[str] | None = None, only: str | None = None, command: Iterable[str] = ()
) -> Stressed:
    """Try the chosen cases, with progress on stderr, and write stress.json into `out`.

    Raises `InputError` as `chosen_cases` does, and `StorageError` if the file cannot be written.
    """
    cases = chosen_cases(methods, only)
    about = provenance(list(command))
    start = time.monotonic()
    results: list[Result] = []
    with steps() as told:
        tell = told("stress")
        for result in run_cases(source(methods), cases):
            results.append(result)
            tell(len(results), len(cases))
    seconds = time.monotonic() - start
    return Stressed(tuple(results), seconds, write_record(out, results, seconds, about))
