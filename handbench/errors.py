"""Errors for people: one clear sentence with the name, the value and the remedy.

HandbenchError          anything the command line reports without a traceback (exit code 2)
├── InputError          what the user gave cannot be used
│   ├── Absent              a file that is to be read is not there
│   ├── BadFrame            one frame of a capture cannot be used
│   └── Damaged             a file is not what was written
├── Unsupported         a method cannot do what a protocol asks (shown in the table with its reason)
├── NonFinite           a computation produced NaN or infinity
├── Changed             a method changed what it was given
└── StorageError        the disk is full, or a folder cannot be written
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class HandbenchError(Exception):
    """Base of every error whose text is meant for the user."""

    exit_code = 2


class InputError(HandbenchError, ValueError):
    """The user's input cannot be used; the text names it and says how to mend it."""


class Absent(InputError):
    """A file that is to be read is not there."""


class BadFrame(InputError):
    """One frame of a capture cannot be used; the text begins with its key. Other frames may be sound."""


class Damaged(InputError):
    """A file is not what was written."""


class Unsupported(HandbenchError):
    """A method cannot do what is asked of it; the text is the reason a report shows."""


class NonFinite(HandbenchError, ArithmeticError):
    """A computation produced NaN or infinity."""


class Changed(HandbenchError):
    """A method changed what it was given, so what it answers is not what it was asked; the text says what."""


class StorageError(HandbenchError, OSError):
    """A file or folder cannot be written."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> InputError:
    """An `InputError` for a name that is not registered, with the closest known names."""
    names = sorted(known)
    # looking for what is close takes minutes for a name as long as a book
    close = difflib.get_close_matches(name, names, n=2, cutoff=0.5) if len(name) <= 100 else []
    hint = f"did you mean {' or '.join(map(repr, close))}?" if close else f"known: {', '.join(names)}"
    return InputError(f"unknown {kind} {shortened(name)}; {hint}")


def text_of(error: BaseException) -> str:
    """What an exception says, in one line that can be kept in a file, whatever its class makes of being asked.

    What is no character, such as a byte of a path that is no UTF-8, is written as an escape.
    """
    try:
        text = str(error)
    except Exception:  # of a class that is broken itself
        text = "what it says cannot be told"
    return " ".join(text.encode("utf-8", "backslashreplace").decode().split())


def trace_of(error: BaseException) -> str:
    """The traceback of an exception as a text that can be kept in a file."""
    import traceback

    return "".join(traceback.format_exception(error)).encode("utf-8", "backslashreplace").decode()


def shortened(value: object) -> str:
    """A value as it is written in a sentence, in some 60 characters at most, whatever it is."""
    if isinstance(value, int) and value.bit_length() > 200:
        return f"a whole number of {value.bit_length()} bits"
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # a number with thousands of digits inside, or lists in lists
        text = f"a {type(value).__name__} that is too large to be shown"
    return text if len(text) <= 60 else f"{text[:50]}… ({len(text)} characters)"
