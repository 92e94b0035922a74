"""A planted suite for the runner: one case of every kind of good and bad behaviour."""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from handbench.errors import HandbenchError, InputError, NonFinite, Unsupported
from handbench.studies.stress.case import Case
from handbench.studies.stress.judgement import Expected, TruthPair, accurate, equal, finite, refused


def _raises(error: Exception) -> Callable[[], Any]:
    def run() -> Any:
        raise error

    return run


def _endless_native() -> None:
    """A loop in native code that holds the interpreter's lock, so that no signal handler of Python can run."""
    ctypes.pythonapi.PyRun_SimpleString(b"while True: pass")


PLANTED: tuple[tuple[str, Expected, Callable[[], Any], bool, str], ...] = (
    # name, expectation, what it does, does it pass, what the observation says
    ("finite", finite(), lambda: np.ones(3), True, "finite"),
    ("accurate", accurate(1e-5), lambda: TruthPair(np.float32(1 / 3), 1 / 3), True, "relative error"),
    ("hangs", finite(), lambda: time.sleep(60), False, "hangs: no answer within 1 s"),
    ("inaccurate", accurate(1e-9), lambda: TruthPair(np.float32(1 / 3), 1 / 3), False, "relative error"),
    ("exits", finite(), lambda: os._exit(3), False, "crashes: the process ended with exit code 3"),
    ("faults", finite(), lambda: ctypes.string_at(0), False, "crashes: the process ended with SIGSEGV"),
    ("hangs in native code", finite(), _endless_native, False, "hangs: no answer within 1 s"),
    ("silent NaN", finite(), lambda: np.array([1.0, np.nan]), False, "1 of 2 values are NaN or infinite"),
    ("silent infinity", accurate(1.0), lambda: TruthPair(np.inf, 1.0), False, "1 of 1 values are NaN or infinite"),
    ("reference with NaN", accurate(1.0), lambda: TruthPair(1.0, np.nan), False, "the reference itself is not finite"),
    ("no values", finite(), lambda: np.zeros(0), False, "an answer without values"),
    ("another shape", equal(), lambda: TruthPair(np.ones(2), np.ones(3)), False, "shapes [(2,)] instead of [(3,)]"),
    ("not black", equal(1.0), lambda: TruthPair(np.ones(2), np.zeros(2)), False, "values other than zero"),
    ("refused", refused(InputError), _raises(InputError("size 0 is too small")), True, "InputError: size 0"),
    ("refused otherwise", refused(InputError), _raises(NonFinite("it diverged")), False, "NonFinite: it diverged"),
    ("refused where it should answer", finite(), _raises(Unsupported("cannot")), False, "Unsupported: cannot"),
    ("answers where it should refuse", refused(InputError), lambda: 1.0, False, "an answer instead of an error"),
    ("refused in many lines", refused(InputError), _raises(InputError("a\nb")), False, "without one clear sentence"),
    ("refused without a word", refused(HandbenchError), _raises(HandbenchError("")), False, "without one clear"),
    ("untyped error", refused(InputError), _raises(ValueError("size 0")), False, "raised ValueError: size 0"),
    ("last", finite(), lambda: 1.0, True, "finite"),
)


def suite() -> tuple[Case, ...]:
    return tuple(Case("planted", name, expected, run, limit=1.0) for name, expected, run, _, _ in PLANTED)


def broken() -> tuple[Case, ...]:
    raise RuntimeError("the suite cannot be built")
