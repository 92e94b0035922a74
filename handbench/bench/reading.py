"""A run folder as it is read: the plan of the last run, its finished cells, and whether two runs can be compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..method import Role
from .store import Store

_PLANNED = ("protocol", "methods", "seeds", "capture", "cells", "provenance")  # what run.json must tell


@dataclass(frozen=True)
class Run:
    """A run as it lies on disk: `plan` is run.json, `cells` are the finished cells in the order of the plan."""

    folder: Path
    plan: dict[str, Any]

    @cached_property
    def cells(self) -> tuple[dict[str, Any], ...]:
        """Read when first asked for; a cell that is absent or damaged is left out."""
        store = Store(self.folder)
        return tuple(cell for cell in map(store.cell, self.plan["cells"]) if cell is not None)

    def of_method(self, name: str) -> tuple[dict[str, Any], ...]:
        return tuple(cell for cell in self.cells if cell["method"]["name"] == name)

    @property
    def protocol(self) -> str:
        """ "quick@1"."""
        return f"{self.plan['protocol']['name']}@{self.plan['protocol']['version']}"


def read_run(folder: Path) -> Run:
    """Raises `InputError` for a folder without a readable run and for one that a newer version wrote."""
    return Run(folder, read_plan(folder))


def read_plan(folder: Path) -> dict[str, Any]:
    plan = Store(folder).run()
    if plan is None:
        raise InputError(f"{folder} holds no readable run.json; give the folder that 'handbench run' printed")
    lacking = [name for name in _PLANNED if name not in plan]
    if lacking:
        raise InputError(
            f"{folder / 'run.json'} lacks {', '.join(lacking)}; it is damaged, so run again into this folder"
        )
    return plan


def role_of(method: Mapping[str, Any]) -> Role:
    """Whether a method of a run competes or calibrates. Runs before there was a role told it by other fields."""
    if "role" in method:
        return "calibration" if method["role"] == "calibration" else "method"
    return "calibration" if method["truth"] or method["fidelity"].startswith("calibration") else "method"


def mismatch(first: Run, other: Run) -> str | None:
    """Why values of two runs cannot stand in one table, in one clause that names both; None if they can."""
    one, two = first.plan["protocol"], other.plan["protocol"]
    if (first.protocol, one["digest"]) != (other.protocol, two["digest"]):
        digests = [f"{protocol['digest'][:8]}" for protocol in (one, two)]
        told = [f"{run.folder} ran {run.protocol} ({d})" for run, d in zip((first, other), digests, strict=True)]
        return f"the protocols differ: {', '.join(told)}"
    signatures = [{metric["signature"] for metric in protocol["metrics"]} for protocol in (one, two)]
    if signatures[0] != signatures[1]:
        return f"the metrics differ: {', '.join(sorted(signatures[0] ^ signatures[1]))} is in one run only"
    if first.plan["capture"]["digest"] != other.plan["capture"]["digest"]:
        told = [f"{run.folder} used {_capture(run)}" for run in (first, other)]
        return f"the data differ: {', '.join(told)}"
    for column, again in zip(one["columns"], two["columns"], strict=True):
        if column["queries"] != again["queries"]:
            return f"the scored frames of column {column['name']!r} differ between {first.folder} and {other.folder}"
    return None


def _capture(run: Run) -> str:
    capture = run.plan["capture"]
    return f"{' '.join(filter(None, (capture['name'], capture.get('size'))))} ({capture['digest'][:8]})"
