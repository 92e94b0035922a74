"""Errors for people: one clear sentence with the name, the value and the remedy.

HandbenchError          anything the command line reports without a traceback (exit code 2)
├── InputError          what the user gave cannot be used
│   └── Absent              a file that is to be read is not there
├── Unsupported         a method cannot do what a protocol asks (shown in the table with its reason)
├── NonFinite           a computation produced NaN or infinity
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


class Unsupported(HandbenchError):
    """A method cannot do what is asked of it; the text is the reason a report shows."""


class NonFinite(HandbenchError, ArithmeticError):
    """A computation produced NaN or infinity."""


class StorageError(HandbenchError, OSError):
    """A file or folder cannot be written."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> InputError:
    """An `InputError` for a name that is not registered, with the closest known names."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=2, cutoff=0.5)
    hint = f"did you mean {' or '.join(map(repr, close))}?" if close else f"known: {', '.join(names)}"
    return InputError(f"unknown {kind} {name!r}; {hint}")
