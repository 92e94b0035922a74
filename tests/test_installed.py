"""What is told of installed packages is what importlib.metadata finds, however often it is asked and whatever comes."""

from __future__ import annotations

import importlib.metadata
import os
from pathlib import Path

import pytest

from handbench.installed import owner_version, points, version


def install(folder: Path, name: str, number: str, listed: str) -> None:
    about = folder / f"{name}-{number}.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {number}\n")
    (about / "entry_points.txt").write_text(f"[handbench.tests]\n{name} = {name}:THING\n")
    (about / "RECORD").write_text(listed)


def test_it_is_what_the_standard_library_finds_by_going_through_everything() -> None:
    owners = importlib.metadata.packages_distributions()
    for module in ("numpy", "torch", "PIL", "handbench", "pytest", "xdist", "json", "nothing_of_this_name"):
        first = [importlib.metadata.version(name) for name in owners.get(module, ())][:1]
        assert owner_version(module) == (first[0] if first else None), module
    assert points("pytest11") == tuple(importlib.metadata.entry_points(group="pytest11")) != ()
    assert version("numpy") == importlib.metadata.version("numpy") and version("nothing-of-this-name") is None


def test_what_is_installed_and_removed_meanwhile_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert points("handbench.tests") == ()
    monkeypatch.syspath_prepend(str(tmp_path))
    assert version("first") is None and owner_version("first") is None
    install(tmp_path, "first", "1.5", "first/__init__.py,sha256=x,3\nfirst.txt,,\n")
    os.utime(tmp_path, ns=(1, 1))  # a clock may be too coarse to tell two changes apart that a test makes
    assert [point.name for point in points("handbench.tests")] == ["first"]
    assert version("first") == owner_version("first") == "1.5"
    install(tmp_path, "second", "2.0", "seconds.py,,\nother/second.py,,\n")
    os.utime(tmp_path, ns=(2, 2))
    assert {point.name for point in points("handbench.tests")} == {"first", "second"}
    assert owner_version("seconds") == owner_version("other") == "2.0" and owner_version("second") is None
    for path in (tmp_path / "first-1.5.dist-info").iterdir():
        path.unlink()
    (tmp_path / "first-1.5.dist-info").rmdir()
    os.utime(tmp_path, ns=(3, 3))
    assert version("first") is None and [point.name for point in points("handbench.tests")] == ["second"]
