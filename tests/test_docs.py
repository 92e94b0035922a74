"""The documentation: it builds without a warning, says what the program does, and its tutorial runs."""

from __future__ import annotations

import importlib.util
import json
import re
import shlex
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import handbench
from handbench.cli import parser
from handbench.data.environments import read_environment
from handbench.light.environment import directions
from handbench.methods.reflectance import model

ROOT = Path(__file__).parents[1]
DOCS = sorted((ROOT / "docs").rglob("*.md"))


def site():
    spec = importlib.util.spec_from_file_location("site_hooks", ROOT / "maintainer" / "site.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_tutorial_runs(tmp_path, monkeypatch, capsys):
    """Cell by cell in one namespace, as a kernel would: an error is a failure. Phong looks at few frames."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(model.PRESETS, "quick", replace(model.PRESETS["quick"], texture=32, fit_frames=3))
    monkeypatch.setattr(handbench, "run", partial(handbench.run, subjects=["s02"]), raising=False)  # less to draw
    cells = json.loads((ROOT / "examples" / "tutorial.ipynb").read_text())["cells"]
    found: dict = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec(compile("".join(cell["source"]), cell["id"], "exec"), found)
    out = capsys.readouterr().out
    assert found["results"].mean("psnr", found["columns"][0])["oracle"] == 100.0
    assert "1 cells computed, 2 taken from the first run" in out


def test_the_reference_has_every_verb_and_every_preset():
    pages = site()
    told = pages.commands()
    for name, verb in pages.verbs(parser()):
        assert f"## handbench {name}\n" in told
        for action in verb._actions:
            assert all(option in told for option in action.option_strings if option not in ("-h", "--help"))
    assert re.search(r"\| `steps` \| 30 \| 600 \| 2000 \| 20000 \|", pages.presets())
    assert "| `lpips-vgg` |" in pages.names()


def test_the_readme_names_every_verb():
    (verbs,) = (action.choices for action in parser()._actions if hasattr(action, "choices") and action.choices)
    text = (ROOT / "README.md").read_text()
    assert [verb for verb in verbs if f"handbench {verb}" not in text and f"`{verb}`" not in text] == []


@pytest.mark.parametrize("path", [*DOCS, ROOT / "README.md", ROOT / "CONTRIBUTING.md"], ids=lambda path: path.name)
def test_commands_in_the_documentation_are_commands(path):
    """Every `handbench …` in code can be parsed: no flag is made up, none is forgotten after a change."""
    text = path.read_text(encoding="utf-8")
    blocks = re.findall(r"`(handbench [^`]*)`", text.replace("\n", " "))
    blocks += [
        line.strip() for block in re.findall(r"^(?: {4}.*\n)+", text, re.MULTILINE) for line in block.splitlines()
    ]
    for line in blocks:
        if not line.startswith("handbench ") or re.search(r"[…\\]|VERB|\$\(|\| |NAME=|\.\.\.", line):
            continue
        try:
            words = shlex.split(line.split("  ")[0], comments=True)
        except ValueError:
            continue
        words = words[: next((i for i, word in enumerate(words) if word.startswith((">", "|", "&"))), None)]
        try:
            parser().parse_args(words[1:])
        except SystemExit as stop:
            required = re.fullmatch(r"handbench( [a-z]+){1,2}", " ".join(words))  # a verb that is only named
            assert stop.code == 0 or required, f"{path.name}: {line}"


def test_the_site_is_built_without_a_warning(tmp_path, monkeypatch):
    pytest.importorskip("mkdocs", reason="the extra 'docs' is not installed; 'make docs' installs it")
    pytest.importorskip("mkdocstrings", reason="the extra 'docs' is not installed; 'make docs' installs it")
    monkeypatch.setenv("NO_MKDOCS_2_WARNING", "1")
    monkeypatch.chdir(ROOT)
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    build(load_config(str(ROOT / "mkdocs.yml"), strict=True, site_dir=str(tmp_path / "site")))  # a warning ends it
    for page in ("index.html", "tutorial/index.html", "reference/python/index.html"):
        assert (tmp_path / "site" / page).is_file()
    assert "handbench.interface.run" in (tmp_path / "site" / "reference" / "python" / "index.html").read_text()


def test_the_one_texel_map_of_the_docs_is_written_and_lies_where_it_says(tmp_path, monkeypatch):
    code = (ROOT / "docs" / "environment-maps.md").read_text().partition("```python")[2].partition("```")[0]
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "environment-maps.md", "exec"), {})
    radiance = read_environment(tmp_path / "sun-x.exr").radiance
    row, column = np.unravel_index(radiance.sum(axis=-1).argmax(), radiance.shape[:2])
    assert directions(*radiance.shape[:2])[row, column] @ [1.0, 0.0, 0.0] > 0.98
