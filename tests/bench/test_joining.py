"""A second command in a run folder adds to its tables; what must leave them is named."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from handbench.bench.joining import joined, kept
from handbench.bench.store import Store
from handbench.reports import table
from handbench.results.record import CellRecord, RunRecord

sys.path.append(str(Path(__file__).parent / "fakes"))
from runfakes import write_run


def _plan(folder: Path) -> tuple[RunRecord, dict[str, CellRecord]]:
    store = Store(folder)
    plan = store.read_run()
    assert plan is not None
    return plan, {key: cell for key in plan.cells if (cell := store.read_cell(key)) is not None}


def test_rows_and_seeds_of_earlier_commands_stay(tmp_path: Path) -> None:
    before, cells = _plan(write_run(tmp_path / "before", methods=("oracle", "good", "fair"), seeds=(0, 1)))
    now, more = _plan(write_run(tmp_path / "now", methods=("oracle", "fair"), seeds=(0,), salt={"fair": "other code"}))
    oracle = {key for key, cell in cells.items() if cell.method.name == "oracle"}
    found = joined(now, before, cells.get, oracle)
    assert [method.name for method in found.record.methods] == ["oracle", "good", "fair"], "in the order there was"
    assert found.record.seeds == (0,) and found.record.seeds_of == {"oracle": (0, 1), "good": (0, 1)}
    assert found.gone == (
        "fair seed 0 (made by other code or settings)",
        "fair seed 1 (made by other code or settings)",
    )
    assert kept(found.record, ["oracle", "fair"]) == ("good (seeds 0, 1)",)
    store = Store(tmp_path / "both")
    for cell in (*cells.values(), *more.values()):
        store.write_cell(cell)
    store.write_run(found.record)
    rows = {row.name: row for row in table(store.folder).rows}
    assert all(cell.complete for row in rows.values() for cell in row.cells), "each over its own seeds"
    assert rows["good"].cells[0].expected == 96 and rows["fair"].cells[0].expected == 48


def test_a_plan_that_holds_the_earlier_one_or_none_stays_as_it_is(tmp_path: Path) -> None:
    before, cells = _plan(write_run(tmp_path / "before", methods=("oracle", "good")))
    now, _ = _plan(write_run(tmp_path / "now"))
    assert joined(now, None, cells.get, ()).record == now
    assert joined(now, before, cells.get, ()).record == now


def test_what_was_never_computed_is_no_row(tmp_path: Path) -> None:
    before, _ = _plan(write_run(tmp_path / "before", methods=("oracle", "good")))
    now, _ = _plan(write_run(tmp_path / "now", methods=("fair",)))
    assert joined(now, before, lambda key: None, ()).record == now


def test_rows_of_another_protocol_or_other_data_leave_by_name(tmp_path: Path) -> None:
    before, cells = _plan(write_run(tmp_path / "before", methods=("oracle", "good")))
    now, _ = _plan(write_run(tmp_path / "now", methods=("fair",), digest="e" * 64))
    found = joined(now, before, cells.get, ())
    assert found.record == now
    assert found.gone == tuple(
        f"{name} (of toy@1, another version or other settings of it)" for name in ("oracle", "good")
    )
    other = replace(now, protocol=before.protocol, capture=replace(before.capture, digest="f" * 16))
    assert joined(other, before, cells.get, ()).gone == ("oracle (of other data)", "good (of other data)")
