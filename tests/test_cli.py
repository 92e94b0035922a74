"""The command line: exit codes, one-line errors, and a quick start."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest

import handbench.methods
import handbench.reports
from handbench import registry
from handbench.bench import check, run
from handbench.bench.run import RunSummary
from handbench.cli import main
from handbench.errors import InputError
from handbench.registry import CAPTURES, METHODS, Entry


def test_help_imports_nothing_heavy():
    code = (
        "import sys\n"
        "from handbench.cli import main\n"
        "try:\n    main(['--help'])\n"
        "except SystemExit as stop:\n    assert stop.code == 0\n"
        "heavy = {'numpy', 'torch', 'rich', 'handbench.scene', 'handbench.methods'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "usage: handbench" in done.stdout


def test_list_does_not_load_what_it_lists(capsys):
    assert main(["list"]) == 0
    out = capsys.readouterr().out
    for word in ("quick", "urhand-ablation-standard", "urhand", "lpips-vgg", "openstage"):
        assert word in out
    assert main(["list", "methods"]) == 0
    assert "psnr" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["run", "quik"], "handbench: unknown protocol 'quik'; did you mean 'quick'"),
        (
            ["run", "smoke", "--methods", "urhnad"],
            "handbench: unknown method 'urhnad'; did you mean 'urhand' or 'urhand-phong'?\n",
        ),
        (["check", "ohy"], "handbench: unknown method 'ohy'; known: "),
        (
            ["data", "make", "openstag"],
            "handbench: unknown capture 'openstag'; did you mean 'openstage' or 'openscans'?\n",
        ),
        (["run", "absent.toml"], "handbench: protocol file absent.toml does not exist; check its path\n"),
        (["relight", "a.avatar", "--light", "hall", "--out", "."], "handbench: --out . names no video, picture or"),
        (["personalise", "uhm", "--from", "mine", "--out", "."], "handbench: --out . has no name; "),
        (["personalise", "uhm", "--from", "x", "--out", "y", "--licence", "a\nb"], "handbench: --licence is no line"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(command, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(command) == 2
    out, err = capsys.readouterr()
    assert err.startswith(message) and err.count("\n") == 1 and out == ""
    assert not list(tmp_path.iterdir())


def test_debug_shows_the_traceback(monkeypatch, capsys):
    monkeypatch.setenv("HANDBENCH_DEBUG", "1")
    assert main(["run", "quik"]) == 2
    err = capsys.readouterr().err
    assert "Traceback" in err and "did you mean 'quick'" in err


@pytest.mark.parametrize(
    "arguments",
    [
        *(
            ["run", "quick", "--seeds", text]
            for text in ("a", "-1", "", "0,,1", "9223372036854775808", "9" * 5000, "٣")
        ),
        *(["run", "quick", *wrong] for wrong in (["--methods", ","], ["--fast"], ["--preset", ""], ["--cpus", "0"])),
        ["check", "mean", "--preset", " "],
        ["geometry", "smoke", "--seed", "-1"],
        *(["relight", "a.avatar", "--light", "hall", "--out", "a.png", "--exposure", x] for x in ("3000", "nan", "")),
        ["gate", "a", "--baseline", "b", "--quality", "psnr=1e999"],
        ["gate", "a", "--baseline", "b", "--quality", f"{'9' * 400}%"],
    ],
)
def test_arguments_that_make_no_sense(arguments, capsys):
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2 and "Traceback" not in capsys.readouterr().err


def test_stopping_is_told_and_what_is_kept_only_by_verbs_that_keep_it(monkeypatch, capsys):
    def stop(*arguments: object, **named: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "run", stop)
    monkeypatch.setattr(check, "check", stop)
    assert main(["run", "smoke"]) == 130
    assert capsys.readouterr().err.endswith("what was finished is kept, the same command goes on from there\n")
    assert main(["check", "mean"]) == 130
    assert capsys.readouterr().err == "handbench: stopped\n"


@pytest.mark.parametrize(
    "command", [["check", "mean"], ["check", "oracle"], ["run", "smoke", "--methods", "mean,oracle"]]
)
def test_a_preset_that_no_method_has_is_refused(command, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([*command, "--preset", "nonsense"]) == 2
    assert "there is no preset 'nonsense'" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_targets_are_looked_at_before_the_work(capsys, tmp_path, monkeypatch):
    def work(*arguments: object, **named: object) -> None:
        raise AssertionError("worked before the target was looked at")

    (tmp_path / "file").touch()
    monkeypatch.setattr("handbench.studies.speed.study.study", work)
    monkeypatch.setattr("handbench.studies.stress.run.stress", work)
    monkeypatch.setattr("handbench.studies.geometry.study.run", work)
    monkeypatch.setattr("handbench.cli.data._capture", work)
    monkeypatch.setattr("handbench.bench.score._asked", work)
    for verb in (["speed"], ["stress"], ["geometry", "smoke"], ["data", "show", "openstage"]):
        for target in (tmp_path / "file" / "below", Path("/dev/null")):
            assert main([*verb, "--out", str(target)]) == 2
            assert re.search("is a (file|device)|Not a directory", capsys.readouterr().err)
    assert main(["score", "smoke", str(tmp_path), "--out", str(tmp_path / "run")]) == 2
    assert "is in the prediction folder, which is only read" in capsys.readouterr().err


@pytest.mark.parametrize(("crashed", "code"), [((), 0), (("urhand s01 seed 0: crashed",), 1)])
def test_run_writes_the_report_and_says_where(monkeypatch, capsys, tmp_path, crashed, code):
    given = []

    def fake(*arguments: object, **named: object) -> RunSummary:
        given.append(arguments)
        return RunSummary(tmp_path, 3, 2, crashed)

    monkeypatch.setattr(run, "run", fake)
    monkeypatch.setattr(handbench.reports, "write_reports", lambda folder, table: {"index.html": folder / "index.html"})
    monkeypatch.setattr(handbench.reports, "table", lambda folder: "the table")
    monkeypatch.setattr(handbench.reports, "render_terminal", lambda table: table)
    assert main(["run", "smoke", "--methods", "mean, phong", "--seeds", "0,2", "--out", str(tmp_path)]) == code
    protocol, *rest = given[0]
    assert protocol.name == "smoke" and rest[:4] == [("mean", "phong"), (0, 2), None, tmp_path]
    out, err = capsys.readouterr()
    assert "the table" in out and "3 cells computed, 2 reused" in out
    assert f"report: {tmp_path / 'index.html'}" in out
    assert ("handbench: urhand s01" in err) == bool(crashed)


@pytest.mark.parametrize(("holds", "code"), [(True, 0), (None, 0), (False, 1)])
def test_a_broken_law_is_exit_code_1(monkeypatch, capsys, holds, code):
    monkeypatch.setattr(check, "check", lambda *arguments: [check.Finding("linear", holds, "largest deviation 1e-9")])
    assert main(["check", "urhand"]) == code
    assert "largest deviation" in capsys.readouterr().out


def test_report_of_a_folder_without_a_run(tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 2
    assert str(tmp_path) in capsys.readouterr().err


def test_report_formats(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(handbench.reports, "table", lambda *folders, **chosen: SimpleNamespace(of=folders[0]))
    monkeypatch.setattr(handbench.reports, "render_latex", lambda table, style: f"latex of {table.of}\n")
    assert main(["report", str(tmp_path), "--format", "latex"]) == 0
    assert capsys.readouterr().out == f"latex of {tmp_path}\n"


def test_a_broken_plugin_hides_no_other(monkeypatch, capsys):
    monkeypatch.setattr(handbench.methods, "GOOD", Entry("good", "json:loads", "fine"), raising=False)

    def point(name: str, target: str) -> metadata.EntryPoint:
        return metadata.EntryPoint(name, target, "handbench.methods")

    good = point("good", "handbench.methods:GOOD")
    points = [point("gone", "no_such_package:ENTRY"), point("tuple", "handbench.methods:ENTRIES"), good]
    monkeypatch.setattr(registry, "points", lambda group: points)
    assert METHODS.load("good") is json.loads and METHODS.entry("mean").name == "mean"
    with pytest.raises(InputError, match=r"'gone' is broken: ModuleNotFoundError: .*uninstall or mend it"):
        METHODS.entry("gone")
    with pytest.raises(InputError, match=r"'tuple' is broken: .*ENTRIES is no handbench.registry.Entry"):
        METHODS.load("tuple")
    assert main(["list", "methods"]) == 0
    out = capsys.readouterr().out
    assert "urhand" in out and "broken: ModuleNotFoundError: No module named 'no_such_package'" in out
    points.append(good)
    with pytest.raises(InputError, match="'good' is broken: two method plug-ins have this name"):
        METHODS.entry("good")
    assert METHODS.entry("mean").name == "mean"


@pytest.mark.parametrize("verb", ["show", "check"])
def test_what_only_looks_makes_nothing(verb, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["data", verb, "openstage", "--data", str(tmp_path / "captures")]) == 2
    err = capsys.readouterr().err
    remedy = f"handbench data make openstage --size quick --folder {tmp_path / 'captures'}"
    assert f"openstage of size quick is not made yet; '{remedy}' makes it" in err
    assert not list(tmp_path.iterdir())


def test_data_show_tells_how_far_it_is(monkeypatch, capsys, tmp_path):
    def source(size, folder, progress):
        progress(3, 3)
        return SimpleNamespace(name="made")

    entry = SimpleNamespace(target="handbench.data:toy", load=lambda: source)
    monkeypatch.setattr(type(CAPTURES), "entry", lambda self, name: entry)
    monkeypatch.setattr("handbench.data.contactsheet.summary", lambda capture: "summary")
    monkeypatch.setattr("handbench.data.contactsheet.write_contact_sheet", lambda capture, path: None)
    assert main(["data", "show", "toy", "--out", str(tmp_path / "a.png")]) == 0
    assert "capture toy quick 3/3" in capsys.readouterr().err
