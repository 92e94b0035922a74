"""An exception as JSON values, and back: a failure over there has the reason it would have had here."""

from __future__ import annotations

import traceback
from typing import Any

from ..errors import HandbenchError, InputError, NonFinite, StorageError, Unsupported, text_of

_KNOWN: dict[str, type[Exception]] = {
    kind.__name__: kind for kind in (Unsupported, NonFinite, InputError, StorageError, HandbenchError, MemoryError)
}


def describe(error: Exception) -> dict[str, Any]:
    """What is told of an exception: its class, the known class it belongs to, its text and its traceback."""
    known = next((name for name, kind in _KNOWN.items() if isinstance(error, kind)), None)
    system = None
    if isinstance(error, OSError) and error.errno is not None:
        system = [error.errno, error.strerror, error.filename and str(error.filename)]
    trace = "".join(traceback.format_exception(error))
    return {"type": type(error).__name__, "known": known, "system": system, "text": text_of(error), "trace": trace}


def revive(told: dict[str, Any]) -> Exception:
    """The exception that was told of: of the known class, or of one with the same name, with the trace as a note."""
    error: Exception
    if told["known"] is not None:
        error = _KNOWN[told["known"]](told["text"])
    elif told["system"] is not None:
        error = OSError(*told["system"])
    else:
        error = type(told["type"], (RuntimeError,), {})(told["text"])
    error.add_note(f"in the other interpreter:\n{told['trace']}")
    return error
