"""The section of a page that shows a stress run: families with counts and worst errors, failures first."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from handbench.errors import InputError
from handbench.files import read_json
from handbench.studies.stress.case import Result
from handbench.studies.stress.record import FILE, SCHEMA, summaries

from .template import UNREADABLE, environment


def stress_section(run_folder: Path) -> str | None:
    """The HTML of a <section> of its own, styled within, for the stress.json of a run folder; None without one.

    Raises `InputError` for a file that cannot be read or is of another schema.
    """
    path = run_folder / FILE
    if not path.exists():
        return None
    record = _read(path)
    try:
        results = tuple(Result(**case) for case in record["cases"])
        page = environment().get_template("stress.html")
        return page.render(
            families=[(line, [r for r in results if r.family == line.family]) for line in summaries(results)],
            failures=[result for result in results if not result.passed],
            total=len(results),
            seconds=float(record["seconds"]),
            device=record["provenance"]["device"],
            scientific=_scientific,
        )
    except UNREADABLE as error:
        raise InputError(f"{path} lacks what a stress run writes ({error}); run 'handbench stress' again") from error


def _read(path: Path) -> dict[str, Any]:
    record = read_json(path)
    schema = record.get("schema") if isinstance(record, dict) else None
    if schema != SCHEMA:
        raise InputError(f"{path} is of schema {schema}, expected {SCHEMA}; run 'handbench stress' again")
    return record


def _scientific(value: float | None) -> str:
    """ "1.2e-05", "0", or a dash for none."""
    if value is None:
        return "–"
    return "0" if value == 0 else f"{value:.1e}"
