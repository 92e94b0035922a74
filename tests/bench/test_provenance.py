from __future__ import annotations

import importlib.metadata
import subprocess

from handbench.bench.progress import steps
from handbench.bench.provenance import git_state, provenance
from handbench.results.origin import Git, Plugin


def git(folder, *arguments):
    subprocess.run(["git", "-C", folder, "-c", "user.name=n", "-c", "user.email=e@x", *arguments], check=True)


def test_commit_and_dirty_flag_of_the_package_alone(tmp_path):
    package = tmp_path / "package" / "__init__.py"
    package.parent.mkdir()
    package.write_text("")
    assert git_state(package) is None
    git(tmp_path, "init", "-q")
    assert git_state(package) is None, "an untracked copy inside a repository is not part of it"
    git(tmp_path, "add", "package")
    git(tmp_path, "commit", "-qm", "first")
    clean = git_state(package)
    assert len(clean.commit) == 40 and clean.dirty is False
    package.write_text("changed = 1\n")
    assert git_state(package) == Git(clean.commit, True)


def test_provenance_names_packages_machine_and_command():
    found = provenance(["handbench", "run", "my protocol"])
    assert found.command == "handbench run 'my protocol'"
    assert {"numpy", "torch"} <= set(found.packages)
    assert found.device.cores >= 1 and found.device.memory_gb > 0


def test_provenance_names_the_packages_of_plugins(tmp_path, monkeypatch):
    (tmp_path / "plugmodule.py").write_text("")
    for words in (["init", "-q"], ["add", "."], ["commit", "-qm", "first"]):
        git(tmp_path, *words)
    monkeypatch.syspath_prepend(str(tmp_path))
    found = provenance([], ["handbench.methods.mean:create", "plugmodule:create", "numpy.linalg:norm"]).plugins
    assert found.keys() == {"numpy", "plugmodule"}
    assert len(found["plugmodule"].git.commit) == 40 and found["plugmodule"].version is None
    assert found["numpy"] == Plugin(importlib.metadata.version("numpy"), None)
    assert provenance([], ["handbench.methods.mean:create"]).plugins == {}


def test_plain_progress_has_loss_and_end(capsys):
    with steps() as told:
        progress = told("training")
        progress(1, 2, loss=0.5)
        progress(2, 2, loss=0.25)
    assert capsys.readouterr().err.startswith("training 2/2 loss 0.25 (")
