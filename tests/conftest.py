from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import settings

# The same examples every time: a test that fails once fails again. To search further: --hypothesis-profile=default.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Generated things go to a folder of the tests' own: no test depends on the user's cache or fills it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HANDBENCH_DATA", str(tmp_path_factory.mktemp("cache")))
        yield
