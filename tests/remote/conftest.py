from __future__ import annotations

import site
import sys
import venv
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import handbench.data
from handbench.bench.protocol import Protocol
from handbench.method import Method
from handbench.protocols import parse
from handbench.registry import Entry
from handbench.remote import remote_method

FAKES = Path(__file__).parent / "fakes"
TOYS = Path(__file__).parents[1] / "bench" / "fakes"


@pytest.fixture(scope="session")
def python(tmp_path_factory: pytest.TempPathFactory) -> str:
    """An interpreter of its own that has numpy and a torch of long ago, and no handbench."""
    folder = tmp_path_factory.mktemp("other")
    venv.EnvBuilder(symlinks=True).create(folder)
    (packages,) = folder.glob("lib/python*/site-packages")
    installed = Path(np.__file__).parents[1]
    for path in installed.glob("numpy*"):
        (packages / path.name).symlink_to(path)
    (packages / "torch").mkdir()
    (packages / "torch" / "__init__.py").write_text('__version__ = "0.4.1"\n')
    assert packages.resolve() not in [Path(place).resolve() for place in site.getsitepackages()]
    return str(folder / "bin" / "python")


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The fake method in this interpreter."""
    monkeypatch.syspath_prepend(str(FAKES))
    import remotefakes

    yield remotefakes
    sys.modules.pop("remotefakes", None)


@pytest.fixture
def toys(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The toy capture of the bench's tests, registered."""
    monkeypatch.syspath_prepend(str(TOYS))
    import benchfakes

    capture = Entry("toy", "benchfakes:open_toy", "for tests")
    monkeypatch.setattr(handbench.data, "ENTRIES", (*handbench.data.ENTRIES, capture))
    yield benchfakes
    sys.modules.pop("benchfakes", None)


@pytest.fixture
def toy_protocol(toys: ModuleType) -> Protocol:
    """A protocol on the toy capture: one trained and one unseen subject, lights of two kinds."""
    column = {"subjects": "trained", "segments": ["held-out"]}
    columns = [
        {**column, "name": "light", "title": "Light", "lightings": ["olat-03"], "shares": ["subject"]},
        {**column, "name": "env", "title": "Environment", "kinds": ["environment"], "shares": ["subject"]},
        {**column, "name": "subject", "title": "Subject", "subjects": "unseen", "kinds": ["olat"], "shares": ["light"]},
    ]
    table = {
        **{"name": "toy", "version": 1, "title": "Toy", "summary": "for tests", "capture": "toy", "size": "tiny"},
        **{"metrics": ["psnr"], "methods": ["oracle"], "aggregation": ["query", "subject", "seed"]},
        "subjects": {"trained": ["s01"], "unseen": ["s02"]},
        "train": {"segments": ["train"], "lightings": ["olat-0[0-2]"]},
        "enrol": {"segments": ["train"], "kinds": ["full"]},
        "column": columns,
    }
    return parse(table, "toy")


@pytest.fixture
def remote(python: str) -> Iterator[Callable[..., Method]]:
    """Makes fake methods in the other interpreter; keywords say what goes wrong, and limits."""
    made = []
    number = count()

    def make(preset: str = "quick", target: str = "remotefakes:create", **settings: str) -> Method:
        if target == "remotefakes:create":
            settings["test"] = str(next(number))  # a method is made once for the same words
        made.append(remote_method(preset, python=python, target=target, path=str(FAKES), **settings))
        return made[-1]

    yield make
    for method in made:
        method._worker.end()
    remote_method.cache_clear()
