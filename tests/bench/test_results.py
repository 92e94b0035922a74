"""Results through DuckDB: what the views hold, what a query may not do, and files that cannot be read."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handbench.cli import main
from handbench.errors import Damaged, InputError
from handbench.results.query import ResultsDatabase, ResultSet
from handbench.results.reading import Run, mismatch, read_run
from handbench.results.record import CaptureRecord
from handbench.results.values import NOT_COMPUTED, values_of

sys.path.append(str(Path(__file__).parent / "fakes"))
from runfakes import plain, write_run


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that tests may read, not change: two seeds, one frame that diverged."""

    def value(method: str, metric: str, subject: int, seed: int, frame: int) -> float | str:
        if (method, subject, seed, frame) == ("good", 2, 1, 3):
            return "non-finite: 7 values of the prediction are NaN or infinite"
        return plain(method, metric, subject, seed, frame) + seed

    return write_run(tmp_path_factory.mktemp("a") / "run", value, subjects=3, frames=4, seeds=(0, 1))


def _ask(sql: str, *folders: Path) -> ResultSet:
    with ResultsDatabase([read_run(each) for each in folders]) as results:
        return results.query(sql)


def test_scores_are_one_line_a_value(folder: Path) -> None:
    names = "run,protocol,version,column,method,subject,seed,query,kind,metric,signature,value,reason"
    assert ",".join(_ask("SELECT * FROM scores", folder).columns) == names
    counts = "SELECT count(*), count(value), count(reason) FROM scores"
    assert _ask(counts, folder).rows == [(3 * 3 * 2 * 2 * 4 * 2, 288 - 4, 4)]
    one = "SELECT value, metric, kind, run, protocol, version, reason FROM scores WHERE method = 'fair' AND seed = 1"
    one += """ AND query = 's01/light-2/dorsal/olat-1' AND signature = 'lpips|region:mask|v1' AND "column" = 'light'"""
    told = (0.1 * (1 + 0.01 + 0.002) + 1, "lpips", "olat", str(folder), "toy", 1, None)
    assert _ask(one, folder).rows == [told]


def test_cells_methods_and_runs(folder: Path) -> None:
    cells = _ask(
        "SELECT count(*), max(nonlinearity), (SELECT min(known_pose_ms) FROM times), any_value(cpu), any_value(gpus) "
        "FROM cells",
        folder,
    )
    assert cells.rows == [(18, 1e-7, 4.2, "Example CPU", "")]
    assert _ask("SELECT DISTINCT enrolment FROM methods", folder).rows == [("",)]  # a run of before it was told
    methods = _ask("SELECT method, title, truth, preset, config->>'texture' FROM methods", folder)
    assert methods.rows[0] == ("oracle", "Oracle", True, "quick", "64")
    assert _ask("SELECT protocol, version, dirty, capture FROM runs", folder).rows == [("toy", 1, False, "openstage")]


def test_values_as_arrays(folder: Path) -> None:
    run = read_run(folder)
    found = values_of(run)["good", "pose"]
    assert [cell.seed for cell in run.in_order if cell.method.name == "fair"] == [0, 0, 0, 1, 1, 1]
    assert found.values.shape == (2, 2, 12) and found.subjects.tolist() == [0] * 4 + [1] * 4 + [2] * 4
    assert np.argwhere(np.isnan(found.values)).tolist() == [[0, 1, 11], [1, 1, 11]]
    assert found.values[0, 1, 5] == plain("good", "psnr", 1, 1, 1) + 1
    assert [list(reasons.values()) for reasons in found.reasons] == [[1], [1]]


def test_only_cells_of_the_plan_count_and_missing_ones_are_told(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", subjects=2, frames=3)
    plan = json.loads((folder / "run.json").read_text())
    stale = folder / "cells" / f"{plan['cells'][-1]}.json"
    (folder / "cells" / "stale.json").write_text(stale.read_text())
    stale.rename(folder / "cells" / "moved.json")
    run = read_run(folder)
    with ResultsDatabase([run]) as results:
        assert results.query("SELECT count(*) FROM cells").rows == [(5,)]
        found = values_of(run)["fair", "light"]
    assert np.isfinite(found.values[0]).tolist() == [[True] * 3 + [False] * 3]
    assert found.reasons == ({NOT_COMPUTED: 3}, {NOT_COMPUTED: 3})


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is no JSON"),
        ("{", "is no JSON"),
        ("[1]", "is no record but list"),
        ("{}", "schema is missing"),
        ('{"schema": 1, "key": "other"}', "scores is no list"),
        ("\x00\xff", "is no JSON"),
        ("[" * 100_000, "is nested too deep"),
    ],
)
def test_a_damaged_cell_is_named(tmp_path: Path, content: str, message: str) -> None:
    folder = write_run(tmp_path / "run")
    path = next(iter((folder / "cells").iterdir()))
    path.write_text(content, encoding="latin-1")
    with pytest.raises(Damaged, match=rf"^{path} .*{message}; run again"):
        _ask("SELECT 1", folder)


@pytest.mark.parametrize("token", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_a_value_that_is_not_finite_has_a_reason_and_no_value(tmp_path: Path, token: str) -> None:
    folder = write_run(tmp_path / "run", subjects=2, frames=1)
    path = next(iter((folder / "cells").iterdir()))
    cell = json.loads(path.read_text())
    cell["scores"][0]["value"] = 123.456
    path.write_text(json.dumps(cell).replace("123.456", token))
    assert _ask("SELECT reason FROM scores WHERE value IS NULL", folder).rows == [("the value is not finite",)]
    assert _ask("SELECT count(value) FROM scores", folder).rows == [(3 * 2 * 4 - 1,)]


def test_a_cell_of_a_newer_version_is_told(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run")
    path = sorted((folder / "cells").iterdir())[3]
    path.write_text(json.dumps({**json.loads(path.read_text()), "schema": 9}))
    with pytest.raises(InputError, match=rf"{path} was written by a newer version \(schema 9, we read 3\); upgrade"):
        _ask("SELECT 1", folder)


def test_parts_of_a_sharded_run_complete_each_other(tmp_path: Path) -> None:
    parts = [write_run(tmp_path / name, subjects=2) for name in ("a", "b")]
    for part, kept in zip(parts, (0, 1), strict=True):
        for i, path in enumerate(sorted((part / "cells").iterdir())):
            if i % 2 != kept:
                path.unlink()
    assert _ask("SELECT count(*) FROM cells", parts[0]).rows == [(3,)]
    assert _ask("SELECT run, count(*) FROM cells GROUP BY run ORDER BY run", *parts).rows == [
        (str(part), 6) for part in parts
    ]


@pytest.mark.parametrize(
    ("sql", "message"),
    [
        ("SELEC 1", "the query cannot be answered: Parser Error: syntax error at or near"),
        ("SELECT nothing FROM scores", 'Referenced column "nothing" not found'),
        ("SELECT * FROM score", "Did you mean"),
        ("SELECT column FROM scores", 'so write "column" with its quotes'),
        ("", "one SELECT"),
        ("SELECT 1; SELECT 2", "one SELECT"),
        ("DELETE FROM found", "one SELECT"),
        ("CREATE TABLE x (a INT)", "one SELECT"),
        ("COPY (SELECT 1) TO 'out.csv'", "one SELECT"),
        ("INSTALL httpfs", "one SELECT"),
        ("SET lock_configuration = false", "one SELECT"),
        ("SELECT * FROM read_csv('/etc/passwd')", "disabled"),
        ("SELECT * FROM '/etc/passwd'", ""),
        ("SELECT * FROM read_text('https://example.org')", ""),
    ],
)
def test_a_query_only_reads_results(
    folder: Path, sql: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as caught:
        _ask(sql, folder)
    assert message in str(caught.value) and "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_the_verb_prints_a_table_csv_and_json(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sql = "SELECT method, count(value) AS n, any_value(reason) AS why FROM scores GROUP BY method ORDER BY method"
    assert main(["query", str(folder), sql]) == 0
    assert capsys.readouterr().out.split()[:4] == ["method", "n", "why", "fair"]
    assert main(["query", str(folder), sql, "--format", "csv"]) == 0
    assert capsys.readouterr().out.splitlines()[:2] == ["method,n,why", "fair,96,"]
    assert main(["query", str(folder), sql, "--format", "json"]) == 0
    assert json.loads(capsys.readouterr().out)[0] == {"method": "fair", "n": 96, "why": None}
    assert main(["query", str(folder), "DROP VIEW scores"]) == 2
    assert main(["query", str(folder / "nowhere"), "SELECT 1"]) == 2
    err = capsys.readouterr().err.splitlines()
    assert err[0] == "handbench: a query is one SELECT; results are only read"
    assert "holds no readable run.json" in err[1] and len(err) == 2


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "run.json is no JSON; run again into this folder"),
        ("[]", "run.json is no record but list"),
        ('{"schema": 1, "protocol": {}}', "run.json is damaged: protocol.name is missing; run again"),
        ('{"schema": 7}', r"run.json was written by a newer version \(schema 7, we read 3\); upgrade handbench"),
    ],
)
@pytest.mark.parametrize("verb", ["report", "query", "gate", "compare"])
def test_a_folder_that_is_no_run_is_one_sentence(
    folder: Path, tmp_path: Path, content: str, message: str, verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run.json").write_text(content)
    rest = {"report": [], "query": ["SELECT 1"], "gate": ["--baseline", str(tmp_path)], "compare": [str(tmp_path)]}[
        verb
    ]
    first = str(folder if verb in ("gate", "compare") else tmp_path)
    assert main([verb, first, *rest]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and re.search(message, err)


def _changed(run: Run, **changes: object) -> Run:
    return Run(Path("other"), replace(run.plan, **changes))


def test_what_cannot_share_a_table_is_named(folder: Path) -> None:
    run = read_run(folder)
    protocol = run.plan.protocol
    assert mismatch(run, _changed(run)) is None
    newer = _changed(run, protocol=replace(protocol, version=2))
    told = mismatch(run, newer)
    assert told == f"the protocols differ: {folder} ran toy@1 (dddddddd), other ran toy@2 (dddddddd)"
    assert "(eeeeeeee)" in (mismatch(run, _changed(run, protocol=replace(protocol, digest="e" * 64))) or "")
    other = _changed(run, capture=CaptureRecord("openstage", "f" * 16, "quick"))
    told = mismatch(run, other)
    assert told == f"the data differ: {folder} used openstage tiny (cccccccc), other used openstage quick (ffffffff)"
    fewer = _changed(run, protocol=replace(protocol, metrics=protocol.metrics[:1]))
    assert mismatch(run, fewer) == "the metrics differ: lpips|region:mask|v1 is in one run only"
    cut = tuple(replace(column, queries=column.queries[:-1]) for column in protocol.columns)
    told = mismatch(run, _changed(run, protocol=replace(protocol, columns=cut)))
    assert told == f"the scored frames of column 'light' differ between {folder} and other"


def test_reading_results_loads_no_pandas(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "pandas.py").write_text("raise SystemExit('pandas was loaded')")
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from pathlib import Path\n"
        "from handbench.results.reading import read_run\n"
        "from handbench.results.query import ResultsDatabase\n"
        f"run = read_run(Path({str(folder)!r}))\n"
        "with ResultsDatabase([run]) as results:\n"
        "    assert results.query('SELECT * FROM scores').rows\n"
        "assert 'pandas' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
