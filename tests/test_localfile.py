"""A method from a file: loaded, keyed by its code, refused with a sentence."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from handbench.bench.naming import named_methods
from handbench.bench.plan import make_method
from handbench.errors import InputError
from handbench.source import source_digest

GREY = """
from handbench.method import Method, MethodInfo


class Grey(Method):
    info = MethodInfo(name="{name}", title="Grey", summary="a grey hand")
    config = {{}}

    def train(self, recording, seed=0, progress=None):
        raise NotImplementedError

    def load(self, folder):
        raise NotImplementedError


def create(preset="quick"):
    return Grey()
"""


@pytest.fixture(autouse=True)
def path_as_it_was(monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))


def written(folder: Path, stem: str, text: str) -> Path:
    path = folder / f"{stem}.py"
    path.write_text(text)
    return path


def test_a_file_is_a_method_under_the_name_that_it_tells(tmp_path):
    path = written(tmp_path, "localgrey", GREY.format(name="grey"))
    names, extra = named_methods(["oracle", str(path), "oracle"])
    assert names == ("oracle", "grey")
    assert make_method(extra[0], "quick").info.title == "Grey"
    before = source_digest(extra[0].target)
    path.write_text(path.read_text() + "\nPAINT = 3\n")
    assert source_digest(extra[0].target) != before, "an edited file is computed anew"


def test_patterns_are_names(tmp_path):
    assert named_methods(["phon?", "urhand-no-*"])[0][0] == "phong"
    assert "urhand-no-gan" in named_methods(["urhand-no-*"])[0]
    with pytest.raises(InputError, match="unknown method 'urhnad\\*'"):
        named_methods(["urhnad*"])


@pytest.mark.parametrize(
    ("stem", "text", "message"),
    [
        ("localempty", "x = 1\n", "has no create; define create"),
        ("localwrong", "def create(preset='quick'):\n    return 3\n", "create makes a int; define create"),
        ("localargs", "def create():\n    return 3\n", "create fails .TypeError"),
        ("localbroken", "import no_such_package\n", "cannot be loaded .ModuleNotFoundError"),
        ("localexit", "import sys\nsys.exit(1)\n", "cannot be loaded .SystemExit"),
        ("local-dash", "", "has no name that Python can import"),
        ("json", GREY.format(name="grey"), "has the name of another module"),
    ],
)
def test_a_file_that_is_none_is_told(tmp_path, stem, text, message):
    import json  # noqa: F401  (there before the file of its name)

    with pytest.raises(InputError, match=message):
        named_methods([str(written(tmp_path, stem, text))])
    with pytest.raises(InputError, match="does not exist; check its path"):
        named_methods([str(tmp_path / "absent.py")])
