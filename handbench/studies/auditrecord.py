"""What an audit found, kept in the run folder as audit.json, so that a report can say it."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..results.reading import Run
from .record import read_study, write_study

FILE = "audit.json"


@dataclass(frozen=True, slots=True)
class Found:
    """One check: whether it holds, None where there was nothing to check, and what was seen."""

    check: str
    holds: bool | None
    detail: str


@dataclass(frozen=True, slots=True)
class AuditRecord:
    """An audit of a run; `cells` is a digest of the keys of the cells that it doubted."""

    cells: str
    found: tuple[Found, ...]


def keep_audit(run: Run, found: Sequence[Found]) -> Path:
    """Write what an audit found beside its run. Raises `StorageError` where that cannot be."""
    return write_study(run.store.own(run.folder / FILE), AuditRecord(_digest(run), tuple(found)))


def audit_told(run: Run) -> str:
    """What a report says of a run's audit, in a sentence. Raises `InputError` for a damaged record."""
    path = run.store.own(run.folder / FILE)
    if not path.is_file():
        return "Not audited: 'handbench audit' computes again what this run claims."
    record = read_study(AuditRecord, path, "audit")
    if record.cells != _digest(run):
        return "The audit in this folder is of other cells than these; run 'handbench audit' again."
    checked = [each for each in record.found if each.holds is not None]
    broken = [f"{each.check} ({each.detail})" for each in checked if not each.holds]
    if broken:
        return f"The audit found {len(broken)} of {len(checked)} checks broken: {'; '.join(broken)}."
    return f"The audit holds in all {len(checked)} checks."


def _digest(run: Run) -> str:
    return hashlib.sha256("\n".join(sorted(run.plan.cells)).encode()).hexdigest()
