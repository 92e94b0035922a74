"""What is expected of a case and what came of it.

accurate(1e-5)            finite and within 1e-5 of a reference of higher precision
equal(1e-6)               finite and within 1e-6 of the same result got in another way
finite()                  finite, nothing more
refused(InputError)       one of these errors with one clear sentence
finite_or(NonFinite)      finite, or refused with one of these errors
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ...errors import HandbenchError
from ...scene import Array

FLOOR = 1e-2
"""Values below this share of the reference's largest are measured against that share, not against themselves."""

LONGEST = 400
"""Characters of an error that still counts as one clear sentence; it may name a path."""

Norm = Literal["largest", "mean"]


@dataclass(frozen=True)
class TruthPair:
    """What was computed and what it should be: arrays or tensors of one shape, or two tuples of such.

    `norm` "largest": the greatest |value - truth| / max(|truth|, `FLOOR` max |truth|, `least`), so that a wrong small
    value counts too; "mean": sum |value - truth| / sum |truth|, for pictures, where pixels at an edge may differ.
    """

    value: Any
    truth: Any
    norm: Norm = "largest"
    least: float = 0.0


@dataclass(frozen=True)
class Expected:
    """`within`: greatest relative error; `errors`: what may be raised; `answers`: may it answer?"""

    text: str
    within: float | None = None
    errors: tuple[type[HandbenchError], ...] = ()
    answers: bool = True


@dataclass(frozen=True)
class Judgement:
    """`observed` is for people; `error` is the relative error where one was measured."""

    observed: str
    error: float | None
    passed: bool


def accurate(within: float) -> Expected:
    return Expected(f"accurate({within:g})", within)


def equal(within: float = 0.0) -> Expected:
    return Expected(f"equal({within:g})", within)


def finite() -> Expected:
    return Expected("finite")


def refused(*errors: type[HandbenchError]) -> Expected:
    return Expected(f"refused({_names(errors)})", errors=errors, answers=False)


def finite_or(*errors: type[HandbenchError]) -> Expected:
    return Expected(f"finite or {_names(errors)}", errors=errors)


def or_refused(expected: Expected, *errors: type[HandbenchError]) -> Expected:
    """The expectation, or a refusal with one of these errors."""
    return replace(expected, text=f"{expected.text} or {_names(errors)}", errors=errors)


def _names(errors: tuple[type[HandbenchError], ...]) -> str:
    return ", ".join(error.__name__ for error in errors)


def observe(expected: Expected, run: Callable[[], Any]) -> Judgement:
    """Run a case and judge it. NaN or infinity never passes, nor does an error of another kind or an empty answer."""
    try:
        answer = run()
    except HandbenchError as error:
        text = str(error)
        if not text or "\n" in text or len(text) > LONGEST:
            return Judgement(f"{type(error).__name__} without one clear sentence: {_line(text)}", None, False)
        return Judgement(f"{type(error).__name__}: {text}", None, isinstance(error, expected.errors))
    except (Exception, SystemExit) as error:
        return Judgement(f"raised {type(error).__name__}: {_line(str(error))}", None, False)
    return _judge(expected, answer)


def _judge(expected: Expected, answer: Any) -> Judgement:
    values = list(_arrays(answer.value if isinstance(answer, TruthPair) else answer))
    count = sum(array.size for array in values)
    bad = sum(int(np.count_nonzero(~np.isfinite(array))) for array in values)
    if bad:
        return Judgement(f"{bad} of {count} values are NaN or infinite", None, False)
    if not count:
        return Judgement("an answer without values", None, False)
    if not isinstance(answer, TruthPair):
        told = "finite" if expected.answers else "an answer instead of an error"
        return Judgement(told, None, expected.answers and expected.within is None)
    try:
        error = relative_error(values, list(_arrays(answer.truth)), answer.norm, answer.least)
    except ValueError as mismatch:
        return Judgement(str(mismatch), None, False)
    if error == float("inf"):
        return Judgement("values other than zero where all should be zero", None, False)
    return Judgement(f"relative error {error:.1e}", error, expected.within is not None and error <= expected.within)


def relative_error(values: list[Array], truths: list[Array], norm: Norm, least: float = 0.0) -> float:
    """The error of several arrays against their truths, each measured alone, the worst returned.

    Where the truth is zero everywhere the error is zero if the value is, else infinite.
    Raises `ValueError` for different shapes and for a truth that is not finite.
    """
    if [array.shape for array in values] != [array.shape for array in truths]:
        raise ValueError(f"shapes {[a.shape for a in values]} instead of {[a.shape for a in truths]}")
    return max(_relative(value, truth, norm, least) for value, truth in zip(values, truths, strict=True))


def _relative(value: Array, truth: Array, norm: Norm, least: float) -> float:
    if not np.isfinite(truth).all():
        raise ValueError("the reference itself is not finite")
    if not truth.size:
        return 0.0
    off, size = np.abs(value - truth), np.abs(truth)
    if not size.any() and not least:
        return float("inf") if off.any() else 0.0
    if norm == "mean":
        return float(off.sum() / size.sum())
    return float((off / np.maximum(size, max(FLOOR * size.max(), least))).max())


def _arrays(answer: Any) -> Iterator[Array]:
    """Everything numeric in an answer as float64 arrays: numbers, arrays, tensors, predictions, and tuples of these."""
    if isinstance(answer, tuple | list):
        for part in answer:
            yield from _arrays(part)
    elif hasattr(answer, "image") and hasattr(answer, "alpha"):  # a prediction
        yield from _arrays((answer.image, answer.alpha))
    elif hasattr(answer, "detach"):  # a tensor, of whatever precision
        yield answer.detach().double().numpy()
    else:
        yield np.asarray(answer, dtype=np.float64)


def _line(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= 200 else line[:199] + "…"
