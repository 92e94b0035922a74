"""The section of a page that shows a stress run: families with counts and worst errors, failures first."""

from __future__ import annotations

from pathlib import Path

from handbench.studies.stress.record import FILE, read_record, summaries

from .run import machine
from .template import environment


def stress_section(run_folder: Path) -> str | None:
    """The HTML of a <section> of its own, styled within, for the stress.json of a run folder; None without one.

    Raises `InputError` for a file that cannot be read or is no such study.
    """
    if not (run_folder / FILE).exists():
        return None
    record = read_record(run_folder)
    return (
        environment()
        .get_template("stress.html")
        .render(
            families=[(line, [r for r in record.cases if r.family == line.family]) for line in summaries(record.cases)],
            failures=[result for result in record.cases if not result.passed],
            total=record.total,
            seconds=record.seconds,
            machine=machine(record.provenance.device),
            scientific=_scientific,
        )
    )


def _scientific(value: float | None) -> str:
    """ "1.2e-05", "0", or a dash for none."""
    if value is None:
        return "–"
    return "0" if value == 0 else f"{value:.1e}"
