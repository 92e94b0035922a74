"""A cell's key names everything that decides its result, and no time."""

from __future__ import annotations

import sys
import time

import pytest

import handbench.bench.plan as plans
from handbench.bench.plan import make_plan
from handbench.bench.source import source_digest
from handbench.errors import InputError
from handbench.registry import Entry


def key(protocol, capture="digest", methods=("toy",), seeds=(0,), preset=None):
    return make_plan(protocol, capture, methods, seeds, preset).cells[0].key


def test_every_ingredient_changes_the_key(fakes, toy_protocol, monkeypatch):
    protocol = toy_protocol()
    keys = [
        key(protocol),
        key(toy_protocol(version=2)),
        key(toy_protocol(metrics=["ssim"])),
        key(protocol, capture="other"),
        key(protocol, methods=("toy-nan",)),
        key(protocol, seeds=(1,)),
        key(protocol, preset="standard"),
        make_plan(protocol, "digest", ("toy",), (0,)).cells[1].key,  # the other subject
    ]
    monkeypatch.setattr(plans, "__version__", "99.0")
    keys.append(key(protocol))
    monkeypatch.undo()
    assert len(set(keys)) == len(keys)


def test_source_of_method_and_metric_change_the_key(fakes, toy_protocol, monkeypatch):
    before = make_plan(toy_protocol(), "digest", ("toy",)).cells[0]
    real = source_digest
    monkeypatch.setattr(plans, "source_digest", lambda target: real(target) + ("x" if "benchfakes" in target else ""))
    method = make_plan(toy_protocol(), "digest", ("toy",)).cells[0]
    monkeypatch.setattr(plans, "source_digest", lambda target: real(target) + ("x" if "psnr" in target else ""))
    metric = make_plan(toy_protocol(), "digest", ("toy",)).cells[0]
    assert method.key != before.key != metric.key
    assert method.prior != before.prior
    assert metric.prior == before.prior, "a changed metric scores anew and trains nothing"


def test_time_and_titles_do_not_change_the_key(fakes, toy_protocol, monkeypatch):
    before = key(toy_protocol())
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now + 1e6)
    assert key(toy_protocol(title="Other")) == before


def test_subjects_share_a_prior_and_seeds_do_not(fakes, toy_protocol):
    cells = make_plan(toy_protocol(), "digest", ("toy",), (0, 1)).cells
    assert [(cell.subject, cell.seed) for cell in cells] == [("s01", 0), ("s02", 0), ("s01", 1), ("s02", 1)]
    assert len({cell.prior for cell in cells}) == 2


def test_presets_are_by_method(fakes, toy_protocol):
    cells = make_plan(toy_protocol(preset="quick", presets={"toy": "smoke"}), "digest", ("toy", "toy-nan")).cells
    assert {cell.method: cell.preset for cell in cells} == {"toy": "smoke", "toy-nan": "quick"}


def test_nothing_to_run(fakes, toy_protocol):
    with pytest.raises(InputError, match="at least one method"):
        make_plan(toy_protocol(), "digest", methods=())


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A plug-in package: main imports near, near imports far; other is a sibling nobody imports."""
    folder = tmp_path / "plugsource"
    folder.mkdir()
    (folder / "__init__.py").write_text("TABLE = ['main']\n")
    (folder / "main.py").write_text("import json\nfrom .near import thing\n\ndef create():\n    return thing\n")
    (folder / "near.py").write_text("def thing():\n    from . import far\n    return far\n")
    (folder / "far.py").write_text("VALUE = 1\n")
    (folder / "other.py").write_text("VALUE = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    return folder


def test_source_digest_follows_imports(package):
    def digest():
        return source_digest("plugsource.main:create")

    before = digest()
    (package / "other.py").write_text("VALUE = 2\n")
    (package / "__init__.py").write_text("TABLE = ['main', 'other']\n")
    (package / "far.py").write_text("# a comment\nVALUE  =  1\n")
    assert digest() == before, "siblings, the package's table and comments decide nothing"
    (package / "far.py").write_text("VALUE = 2\n")
    changed = digest()
    assert changed != before
    (package / "main.py").write_text("from .near import thing\n\ndef create():\n    return thing, 1\n")
    assert digest() != changed
    assert not any(name.startswith("plugsource") for name in sys.modules), "nothing is imported"


def test_source_digest_follows_into_handbench(monkeypatch, tmp_path):
    (tmp_path / "plugsolo.py").write_text("from handbench.scene import Query\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with_scene = source_digest("plugsolo:create")
    import handbench.bench.source as source

    real = source.ast.parse
    monkeypatch.setattr(source.ast, "parse", lambda text: real(text.replace("Directional", "Sun")))
    assert source_digest("plugsolo:create") != with_scene


def test_every_registered_plugin_has_source():
    from handbench.registry import METHODS, METRICS

    targets = {entry.target for entry in (*METHODS.entries().values(), *METRICS.entries().values())}
    assert len({source_digest(target) for target in targets}) == len(targets)
    assert source_digest("nowhere.at.all:x") != source_digest(Entry("a", "nowhere.else:x", "").target)


@pytest.mark.parametrize("package", ["torch", "jax", "mitsuba"])
def test_another_release_of_a_package_that_computes_is_another_key(fakes, toy_protocol, monkeypatch, package):
    before = key(toy_protocol())
    real = plans.importlib.metadata.version
    monkeypatch.setattr(plans.importlib.metadata, "version", lambda name: "99.0" if name == package else real(name))
    assert key(toy_protocol()) != before
