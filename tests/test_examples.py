"""The example package, installed and used from outside as a reader would; and a broken one beside it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from flat import flat_cells

from handbench.bench.check import check_method
from handbench.bench.run import find_protocol
from handbench.registry import CAPTURES

EXAMPLE = Path(__file__).parents[1] / "examples" / "handbench-example"
Handbench = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example, installed by pip, without a network."""
    copy = shutil.copytree(EXAMPLE, tmp_path_factory.mktemp("source") / "example")
    target = tmp_path_factory.mktemp("installed")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    done = subprocess.run([*command, "--target", str(target), str(copy)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    return target


@pytest.fixture(scope="module")
def handbench(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Handbench:
    """The command line, with the example in sight, in an empty folder."""
    broken = tmp_path_factory.mktemp("broken")
    (broken / "broken_example-1.0.dist-info").mkdir()
    (broken / "broken_example-1.0.dist-info" / "METADATA").write_text("Name: broken-example\nVersion: 1.0\n")
    points = "[handbench.methods]\nbroken = no_such_package:ENTRY\n"
    (broken / "broken_example-1.0.dist-info" / "entry_points.txt").write_text(points)
    here = tmp_path_factory.mktemp("work")

    def run(*arguments: str, with_broken: bool = False) -> subprocess.CompletedProcess[str]:
        paths = [str(installed), *([str(broken)] if with_broken else [])]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "COLUMNS": "200"}
        command = [sys.executable, "-m", "handbench.cli", *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False, cwd=here, env=environment)

    return run


AT_WORK = """
import contextlib, json, os, sys

def told(name, work):
    with open(name, "w") as file, contextlib.redirect_stdout(file), contextlib.redirect_stderr(file):
        return int(work())

import pytest
from handbench.cli import main

codes = {name: told(name, lambda: main(words)) for name, words in json.loads(sys.argv[1]).items()}
codes["tests"] = told("tests", lambda: pytest.main(sys.argv[2:]))
with open("codes.json", "w") as file:
    json.dump(codes, file)
"""


@pytest.fixture(scope="module")
def worked(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what a check, a run and the example's own tests said; one process has loaded torch for all."""
    here = tmp_path_factory.mktemp("work")
    # plug-ins of pytest that happen to be installed are loaded for longer than the tests take
    environment = {**os.environ, "PYTHONPATH": str(installed), "COLUMNS": "200", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    commands = {"check": ["check", "example-lambert", "--protocol", "example"], "run": ["run", "example"]}
    tests = ["-q", "-p", "no:cacheprovider", "--rootdir", str(EXAMPLE), str(EXAMPLE / "tests")]
    command = [sys.executable, "-c", AT_WORK, json.dumps(commands), *tests]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=here, env=environment)
    assert done.returncode == 0, done.stderr
    return here


def said(worked: Path, name: str) -> str:
    """What one of them said, if it ended well."""
    text = (worked / name).read_text()
    assert json.loads((worked / "codes.json").read_text())[name] == 0, text[-4000:]
    return text


def test_it_is_small() -> None:
    code = [path.read_text().splitlines() for path in (EXAMPLE / "src").rglob("*.py")]
    assert sum(map(len, code)) < 250


def test_it_is_listed(handbench: Handbench) -> None:
    done = handbench("list")
    assert done.returncode == 0, done.stderr
    for name in ("example-lambert", "example-mae", "example  ", "example-ball", "urhand"):
        assert name in done.stdout


def test_its_method_obeys_the_laws(worked: Path) -> None:
    assert said(worked, "check").count(" holds ") == 6


def test_its_protocol_runs_with_its_capture_method_and_metric(worked: Path) -> None:
    out = said(worked, "run")
    assert "Lambert" in out and "MAE" in out and "Unseen ball" in out
    cells = flat_cells(worked / "runs" / "example")
    values = {
        name: [
            score["value"]
            for cell in cells
            if cell["method"]["name"] == name
            for score in cell["scores"]
            if score["metric"].startswith("example-mae|region:mask|space:srgb")
        ]
        for name in ("oracle", "mean", "example-lambert")
    }
    assert set(values["oracle"]) == {0.0} and len(values["mean"]) == len(values["example-lambert"]) == 16
    assert sum(values["example-lambert"]) < 0.5 * sum(values["mean"]), "relighting is no better than not relighting"
    page = next(line for line in out.splitlines() if line.startswith("report: "))
    assert (worked / page.removeprefix("report: ")).is_file()


def test_its_own_tests_pass(worked: Path) -> None:
    assert said(worked, "tests").startswith("...")


def test_the_method_of_the_document_obeys_the_laws() -> None:
    text = (EXAMPLE.parents[1] / "docs" / "adding-a-method.md").read_text()
    code = text.split("```python\n")[1].split("```")[0]
    written: dict[str, Any] = {}
    exec(code, written)
    verdicts = check_method(written["create"](), find_protocol("smoke"), CAPTURES.load("openstage")("mini"))
    assert all(verdict.holds is not False for verdict in verdicts), verdicts
    assert written["ENTRY"].name == written["Grey"].info.name == "grey"


def test_a_broken_package_hides_no_other(handbench: Handbench) -> None:
    done = handbench("list", "methods", with_broken=True)
    assert done.returncode == 0, done.stderr
    (line,) = [line for line in done.stdout.splitlines() if line.split()[0] == "broken"]
    assert line.split(maxsplit=1)[1] == (
        "broken: ModuleNotFoundError: No module named 'no_such_package'; uninstall or mend it"
    )
    assert done.stdout.count("broken") == 2 and "example-lambert" in done.stdout and "urhand-phong" in done.stdout
    refused = handbench("run", "example", "--methods", "broken", with_broken=True)
    assert refused.returncode == 2 and refused.stderr == (
        "handbench: plug-in 'broken' is broken: ModuleNotFoundError: No module named 'no_such_package'; "
        "uninstall or mend it\n"
    )
