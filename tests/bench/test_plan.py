"""A cell's key names everything that decides its result, and no time."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

import handbench.bench.plan as plans
import handbench.source as source
from handbench.bench.plan import Cell, make_plan
from handbench.errors import InputError
from handbench.registry import Entry
from handbench.source import source_digest, source_digests


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
    real = plans.source_digests

    def edited(word: str) -> Cell:
        found = lambda targets: {t: code + ("x" if word in t else "") for t, code in real(targets).items()}  # noqa: E731
        monkeypatch.setattr(plans, "source_digests", found)
        return make_plan(toy_protocol(), "digest", ("toy",)).cells[0]

    method, metric = edited("benchfakes"), edited("psnr")
    assert method.key != before.key != metric.key
    assert method.prior != before.prior
    assert metric.prior == before.prior, "a changed metric scores anew and trains nothing"


def test_the_configuration_that_a_plugin_resolves_to_changes_the_key(fakes, toy_protocol, monkeypatch):
    """Wherever a plug-in of another package reads it from: here, from its environment."""
    before = make_plan(toy_protocol(), "digest", ("toy",)).cells[0]
    monkeypatch.setattr(fakes.Toy, "config", {"preset": "quick", "rate": 0.1})
    after = make_plan(toy_protocol(), "digest", ("toy",)).cells[0]
    assert after.key != before.key and after.prior != before.prior
    monkeypatch.setattr(fakes.Toy, "config", {"folder": object()})
    with pytest.raises(InputError, match="plug-in 'toy' has a config that holds no JSON value"):
        make_plan(toy_protocol(), "digest", ("toy",))


def test_a_method_that_is_not_in_our_table_is_asked_for_its_configuration(fakes, toy_protocol, monkeypatch):
    """Its target may be ours and what it runs elsewhere: a folder, or code of another interpreter."""
    asked = []
    monkeypatch.setattr(plans, "make_method", lambda entry, preset: asked.append(entry.name) or fakes.Toy("toy", {}))
    extra = (Entry("mine", "handbench.methods.mean:create", "", (("target", "other:create"),)),)
    make_plan(toy_protocol(), "digest", ("mean", "mine"), extra=extra)
    assert asked == ["mine"]


def test_a_plugin_that_cannot_be_made_is_one_sentence(toy_protocol, tmp_path, monkeypatch):
    (tmp_path / "plugbroken.py").write_text(
        "def create(preset):\n    return {}[preset]\n\ndef other(preset):\n    return 1\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(InputError, match=r"plug-in 'x' at 'plugbroken:create' fails \(KeyError: 'quick'\); mend it"):
        make_plan(toy_protocol(), "digest", ("x",), extra=(Entry("x", "plugbroken:create", ""),))
    with pytest.raises(InputError, match=r"plug-in 'x' at 'plugbroken:other' makes a int, expected a"):
        make_plan(toy_protocol(), "digest", ("x",), extra=(Entry("x", "plugbroken:other", ""),))


def test_settings_of_extra_methods_change_the_key(fakes, toy_protocol, monkeypatch):
    monkeypatch.setattr(plans, "_resolved", lambda *_: None)
    keys = set()
    for settings in ((), (("digest", "a"),), (("digest", "b"),)):
        extra = (Entry("mine", "benchfakes:toy", "", settings),)
        keys.add(make_plan(toy_protocol(), "digest", ("mine",), extra=extra).cells[0].key)
    assert len(keys) == 3
    both = make_plan(toy_protocol(), "digest", extra=(Entry("mine", "benchfakes:toy", ""),))
    assert both.methods == ("toy", "mine"), "after the protocol's methods"


def test_our_own_methods_are_not_loaded_for_their_key():
    code = (
        "import sys\n"
        "from handbench.bench.plan import make_plan\n"
        "from handbench.bench.run import find_protocol\n"
        "make_plan(find_protocol('quick'), 'digest')\n"
        "heavy = {'torch', 'jax', 'open3d', 'mitsuba', 'matplotlib'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


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


@pytest.fixture
def digests(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("HANDBENCH_DATA", str(tmp_path / "cache"))
    return tmp_path / "cache" / "digests.json"


def test_source_digest_covers_data_files_beside_the_code(package, digests):
    found = [source_digest("plugsource.main:create")]
    (package / "weights" / "deep").mkdir(parents=True)
    for name in ("weights/net.safetensors", "weights/deep/net.bin", "settings.yaml"):
        for content in (b"one", b"two"):
            (package / name).write_bytes(content)
            found.append(source_digest("plugsource.main:create"))
    (package / "weights" / "net.safetensors").rename(package / "weights" / "other.safetensors")
    found.append(source_digest("plugsource.main:create"))
    assert len(set(found)) == len(found)
    for ignored in (".hidden", "__pycache__/main.pyc", "sub/__init__.py", "sub/weights.bin", "tool.py"):
        (package / ignored).parent.mkdir(exist_ok=True)
        (package / ignored).write_text("x = 1\n")
    (package / "weights" / "up").symlink_to(package / "weights", target_is_directory=True)
    assert source_digest("plugsource.main:create") == found[-1], "other packages, code nobody imports, links back up"


def test_of_a_single_module_only_weights_beside_it_count(tmp_path, monkeypatch, digests):
    (tmp_path / "plugsingle.py").write_text("VALUE = 1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    before = source_digest("plugsingle:create")
    (tmp_path / "notes.txt").write_text("in the same folder by chance")
    assert source_digest("plugsingle:create") == before
    (tmp_path / "weights").mkdir()
    (tmp_path / "weights" / "net.bin").write_text("1")
    assert source_digest("plugsingle:create") != before


def test_large_weights_are_read_once_until_they_change(package, digests, monkeypatch):
    (package / "weights").mkdir()
    weights = package / "weights" / "net.bin"
    weights.write_bytes(b"first")
    fresh = source_digest("plugsource.main:create")
    assert not digests.exists(), "a file that was just written may change again within the clock's grain"
    monkeypatch.setattr(source, "_SETTLED", -1.0)
    assert source_digest("plugsource.main:create") == fresh and digests.exists()
    reads = []
    real = source.hashlib.file_digest
    monkeypatch.setattr(source.hashlib, "file_digest", lambda file, name: reads.append(file.name) or real(file, name))
    assert source_digest("plugsource.main:create") == fresh and not reads
    times = weights.stat()
    weights.write_bytes(b"other")  # of the same size, and with the old time of modification
    os.utime(weights, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert source_digest("plugsource.main:create") != fresh and reads
    digests.write_text("{")
    assert source_digest("plugsource.main:create") != fresh, "a damaged cache is no trouble"


def test_data_that_cannot_be_read_is_one_sentence(package, digests, monkeypatch):
    (package / "weights.bin").write_bytes(b"1")

    def refuse(file: object, name: str) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(source.hashlib, "file_digest", refuse)
    with pytest.raises(InputError, match=r"data file .*weights\.bin of a plug-in cannot be read \(Permission denied\)"):
        source_digest("plugsource.main:create")


def test_source_digest_follows_into_handbench(monkeypatch, tmp_path):
    (tmp_path / "plugsolo.py").write_text("from handbench.scene import Query\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with_scene = source_digest("plugsolo:create")
    real = source._parsed
    monkeypatch.setattr(source, "_parsed", lambda text: real(text.replace("Directional", "Sun")))
    assert source_digest("plugsolo:create") != with_scene


def test_every_registered_plugin_has_source():
    from handbench.registry import METHODS, METRICS

    targets = {entry.target for entry in (*METHODS.entries().values(), *METRICS.entries().values())}
    digests = source_digests(targets)
    assert len(set(digests.values())) == len(targets)
    assert digests["handbench.methods.mean:create"] == source_digest("handbench.methods.mean:create")
    assert source_digest("nowhere.at.all:x") != source_digest(Entry("a", "nowhere.else:x", "").target)


@pytest.mark.parametrize("package", ["torch", "jax", "mitsuba"])
def test_another_release_of_a_package_that_computes_is_another_key(fakes, toy_protocol, monkeypatch, package):
    before = key(toy_protocol())
    real = plans.version
    monkeypatch.setattr(plans, "version", lambda name: "99.0" if name == package else real(name))
    assert key(toy_protocol()) != before
