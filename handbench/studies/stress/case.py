"""A case: something hard to compute, and what should come of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ...results.schema import told
from .judgement import Expected

LIMIT = 20.0
"""Seconds a case may take; most take milliseconds, the first of a kind compiles something."""


@dataclass(frozen=True)
class Case:
    """`run` computes something; `reference` says what a `Compared` answer is held against; `limit` is in seconds."""

    family: str
    name: str
    expected: Expected
    run: Callable[[], Any]
    reference: str = ""
    limit: float = LIMIT

    @property
    def id(self) -> str:
        return f"{self.family}/{self.name}"


@dataclass(frozen=True)
class Result:
    """What came of a case."""

    family: str = told("its family")
    name: str = told("its name in the family")
    expected: str = told("what should come of it")
    reference: str = told("what its answer was held against")
    observed: str = told("what came of it")
    error: float | None = told("the relative error, where one was measured")
    milliseconds: float = told("what it took")
    passed: bool = told("whether that is as expected")
