from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest

import handbench.data
import handbench.methods
from handbench.bench.protocol import Protocol
from handbench.protocols import parse
from handbench.registry import Entry

FAKES = Path(__file__).parent / "fakes"
NAMES = (
    *(
        "toy",
        "toy-nan",
        "toy-crash",
        "toy-crash-train",
        "toy-memory",
        "toy-diverges",
        "toy-no-environment",
        "toy-small",
        "toy-directional",
    ),
    *(
        "toy-square",
        "toy-forgetful",
        "toy-mutates",
        "toy-lossy",
        "toy-unseeded",
        "toy-identity",
        "toy-full-disk",
        "toy-estimates",
        "toy-needy",
    ),
)


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The toy capture and methods, registered; call counts start at zero."""
    monkeypatch.syspath_prepend(str(FAKES))
    import benchfakes

    toys = tuple(Entry(name, f"benchfakes:{name.replace('-', '_')}", "for tests") for name in NAMES)
    monkeypatch.setattr(handbench.methods, "ENTRIES", (*handbench.methods.ENTRIES, *toys))
    capture = Entry("toy", "benchfakes:open_toy", "for tests")
    monkeypatch.setattr(handbench.data, "ENTRIES", (*handbench.data.ENTRIES, capture))
    benchfakes.CALLS.clear()
    benchfakes.STOP_AT.clear()
    yield benchfakes
    sys.modules.pop("benchfakes", None)


@pytest.fixture
def toy_table() -> Callable[..., dict]:
    """A protocol on the toy capture as a TOML table; keywords replace top-level values."""

    def table(**changes: object) -> dict:
        column = {"title": "Column", "subjects": "trained"}
        columns = [
            {**column, "name": "segment", "segments": ["held-out"], "kinds": ["group"], "shares": ["subject", "light"]},
            {**column, "name": "subject", "subjects": "unseen", "segments": ["held-out"], "kinds": ["group"]},
            {**column, "name": "light", "segments": ["train"], "lightings": ["olat-03"], "shares": ["subject", "pose"]},
            {**column, "name": "env", "segments": ["held-out"], "kinds": ["environment"], "shares": ["subject"]},
        ]
        columns[1]["shares"] = ["light"]
        return {
            "name": "toy",
            "version": 1,
            "title": "Toy",
            "summary": "for tests",
            "capture": "toy",
            "size": "tiny",
            "subjects": {"trained": ["s01"], "unseen": ["s02"]},
            "train": {"segments": ["train"], "lightings": ["olat-0[0-2]", "group-*"]},
            "enrol": {"segments": ["train"], "kinds": ["full"]},
            "column": columns,
            "metrics": ["psnr"],
            "methods": ["toy"],
            "aggregation": ["query", "subject", "seed"],
            **changes,
        }

    return table


@pytest.fixture
def toy_protocol(toy_table: Callable[..., dict]) -> Callable[..., Protocol]:
    return lambda **changes: parse(toy_table(**changes), "toy")
