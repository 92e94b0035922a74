"""What a report reads of a run folder: the plan of the last run and its finished cells."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from handbench.bench.store import Store
from handbench.errors import InputError


@dataclass(frozen=True)
class Run:
    """A run as it lies on disk: `plan` is run.json, `cells` are the finished cells in the order of the plan."""

    folder: Path
    plan: dict[str, Any]
    cells: tuple[dict[str, Any], ...]

    def of_method(self, name: str) -> tuple[dict[str, Any], ...]:
        return tuple(cell for cell in self.cells if cell["method"]["name"] == name)


def read_run(folder: Path) -> Run:
    """Raises `InputError` for a folder without a readable run; a cell that is absent or damaged is left out."""
    store = Store(folder)
    plan = read_plan(folder)
    cells = (store.cell(key) for key in plan["cells"])
    return Run(folder, plan, tuple(cell for cell in cells if cell is not None))


def read_plan(folder: Path) -> dict[str, Any]:
    plan = Store(folder).run()
    if plan is None:
        raise InputError(f"{folder} holds no readable run.json; give the folder that 'handbench run' printed")
    return plan


def machine(provenance: dict[str, Any]) -> str:
    """The device in one line: "AMD EPYC 7B13, 2 cores, 2 threads, 24 GB"."""
    device = provenance["device"]
    parts = [device["cpu"], f"{device['cores']} cores", f"{device['threads']} threads"]
    memory = [f"{device['memory_gb']:.0f} GB"] if device["memory_gb"] else []
    return ", ".join([*parts, *memory, *device["gpus"]])
