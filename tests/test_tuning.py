"""A process that trains or draws multiplies matrices in one thread, unless its user says otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from handbench.tuning import matrix_libraries, tune


@pytest.fixture
def libraries(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Any, ...]]:
    """Those of numpy and scipy, with two threads each."""
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    found = matrix_libraries()
    before = [library.get_num_threads() for library in found]
    for library in found:
        library.set_num_threads(2)
    yield found
    for library, threads in zip(found, before, strict=True):
        library.set_num_threads(threads)


def threads(libraries: tuple[Any, ...]) -> set[int]:
    return {library.get_num_threads() for library in libraries}


def test_products_take_one_thread(libraries: tuple[Any, ...]) -> None:
    assert libraries and threads(libraries) == {2}
    tune()
    assert threads(libraries) == {1}


def test_who_has_said_a_number_keeps_it(libraries: tuple[Any, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    tune()
    assert threads(libraries) == {2}
