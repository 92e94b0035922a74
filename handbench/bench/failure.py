"""What went wrong in a method, as the reason a report shows."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import BadFrame, Changed, HandbenchError, NonFinite, Unsupported, text_of, trace_of


@dataclass(frozen=True)
class Failure:
    """`reason` is for a table's footnote; `trace` is a traceback if running again may help, else None."""

    reason: str
    trace: str | None


def failure(error: BaseException) -> Failure:
    """Describe an exception of a method. What a method cannot do is final; a crash is worth another try.

    A method that ends the process (`sys.exit`) has crashed. Raises `KeyboardInterrupt` again: that was the user.
    """
    if isinstance(error, KeyboardInterrupt):
        raise error
    text = text_of(error)
    if isinstance(error, Unsupported):
        return Failure(f"unsupported: {text}", None)
    if isinstance(error, NonFinite):
        return Failure(f"non-finite: {text}", None)
    trace = trace_of(error)
    if isinstance(error, MemoryError) or "out of memory" in text or "not enough memory" in text:
        return Failure("out of memory", trace)
    if isinstance(error, BadFrame):
        return Failure(f"bad frame: {text}", trace)
    if isinstance(error, Changed):
        return Failure(f"changed what it was given: {text}", trace)
    if isinstance(error, HandbenchError):
        return Failure(f"failed: {text}", trace)
    return Failure(f"crashed: {type(error).__name__}{': ' if text else ''}{text[:200]}", trace)
