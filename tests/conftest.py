from __future__ import annotations

import atexit
import gc
import os
import signal
import tempfile
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import settings
from hypothesis.internal.conjecture import providers

# The same examples every time: a test that fails once fails again. To search further: --hypothesis-profile=default.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")
# Nor do they depend on numbers in the sources of what is imported, which Hypothesis reads for 2 s in each process.
providers._get_local_constants = lambda: providers._local_constants

# a job in the background may have signals ignored, and what the tests start would inherit that
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# Tests of several threads share two cores with other tests: threads that wait must sleep, or a second takes a minute.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

# XLA compiles the same kernels in every process of the tests, for 3 s in one that draws: what one has compiled, the
# others load. The first process of the tests comes here first, its workers and what they start have it from there.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    compiled = tempfile.TemporaryDirectory(prefix="handbench-tests-compiled-")
    atexit.register(compiled.cleanup)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = compiled.name
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.02"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"


# As the command line does: a search for unused cycles goes through all modules, and finds nothing among them.
gc.set_threshold(100_000, 50, 100)

# Begun last, a file that takes long would leave the other process of the tests without work.
LONG = (
    "test_kills.py",
    "test_executor.py",
    "test_examples.py",
    "test_package.py",
    "test_docs.py",
    "test_bad_inputs.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.name not in LONG)


def pytest_collection_finish() -> None:
    gc.freeze()  # what is imported stays


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Generated things go to a folder of the tests' own: no test depends on the user's cache or fills it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HANDBENCH_DATA", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def mano(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """The right hand of the user's MANO files if HANDBENCH_MANO names them, else of synthetic ones."""
    import syntheticmano

    from handbench.hand import hand_model
    from handbench.hand.known import forget

    with pytest.MonkeyPatch.context() as patch:
        if "HANDBENCH_MANO" not in os.environ:
            patch.setenv("HANDBENCH_MANO", str(syntheticmano.write(tmp_path_factory.mktemp("mano"))))
        forget("mano-right", "mano-left")
        yield hand_model("mano-right")
    forget("mano-right", "mano-left")
