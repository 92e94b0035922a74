from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings

# The same examples every time: a test that fails once fails again. To search further: --hypothesis-profile=default.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

# a job in the background may have signals ignored, and what the tests start would inherit that
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Generated things go to a folder of the tests' own: no test depends on the user's cache or fills it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HANDBENCH_DATA", str(tmp_path_factory.mktemp("cache")))
        yield
