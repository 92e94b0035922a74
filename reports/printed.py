"""Values as text, the same in every format: numbers, intervals, p-values, footnote letters, costs."""

from __future__ import annotations

import math
from collections.abc import Sequence

from handbench.results.record import UNEQUAL as UNEQUAL
from handbench.results.statistics import Difference

from .cost import Span
from .model import LIGHT_TITLES, Aggregate, Row, Table

MEMORY_TITLES = ("drawing MiB", "training MiB", "GPU MiB", "avatar MiB", "weights MiB", "parameters", "J a frame")
COST_TITLES = ("train s", "personalise s", "new pose ms", "known pose, new light ms", "min–max", "non-linearity")
SUNK = "▽"  # the mark of a value that is not better than the floor
UNEQUAL_NOTE = f"{UNEQUAL}: compared with rows to which enrolment gave something else"


def listed(words: Sequence[str]) -> str:
    """ "a", "a and b", "a, b and c"."""
    *some, last = words
    return f"{', '.join(some)} and {last}" if some else last


def number(value: float | None, decimals: int) -> str:
    """A value as text: "–" for none, a true minus sign, "∞" for infinity."""
    if value is None:
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = f"{value:.{decimals}f}"
    return text.replace("-", "−") if float(text) != 0 else text.lstrip("-")


def signed(value: float | None, decimals: int) -> str:
    """A difference as text: "+0.52", "−1.30", "0.00"."""
    text = number(value, decimals)
    return f"+{text}" if value is not None and value > 0 and float(f"{value:.{decimals}f}") != 0 else text


def bounds(difference: Difference, decimals: int) -> str:
    """The interval of a difference: "[+0.31, +0.70]", or "" if there is none."""
    if difference.low is None or difference.high is None:
        return ""
    return f"[{signed(difference.low, decimals)}, {signed(difference.high, decimals)}]"


def between(cell: Aggregate, decimals: int) -> str:
    """The interval of a value, in the small print: "24.10–25.92", or "" if there is none."""
    if cell.low is None or cell.high is None:
        return ""
    return f"{number(cell.low, decimals)}–{number(cell.high, decimals)}"


def chance(difference: Difference) -> str:
    """The adjusted p-value: "p 0.031", "p < 0.001", or "" if nothing was tested."""
    if difference.adjusted is None:
        return ""
    return f"p {difference.adjusted:.2g}" if difference.adjusted >= 0.001 else "p < 0.001"


def duration(span: Span | None) -> str:
    """A time with three significant digits at most, e.g. "0.42", "12.3", "1234"."""
    return "–" if span is None else three_digits(span.median)


def three_digits(value: float) -> str:
    return f"{value:.{2 if value < 10 else 1 if value < 100 else 0}f}"


def marks(cell: Aggregate) -> str:
    """The footnote letters of a cell: "a", "a,c"."""
    return ",".join(letter(note) for note in cell.notes)


def letter(note: int) -> str:
    """The letter of footnote 1, 2, …: a … z, then aa, ab, …"""
    head, tail = divmod(note - 1, 26)
    return (letter(head) if head else "") + chr(ord("a") + tail)


def costs_title(table: Table) -> str:
    """The head of the table of costs, which names the light that poses are timed under."""
    return f"Time under {LIGHT_TITLES[table.timed_kind]}, and linearity in light"


def cost_texts(row: Row, kind: str) -> tuple[str, ...]:
    """Times under a kind of light and deviation from linearity as text in the order of `COST_TITLES`."""
    times = row.times
    known = times.known_pose_ms.get(kind)
    spread = f"{three_digits(known.low)}–{three_digits(known.high)}" if known else "–"
    seconds = map(duration, (times.train_s, times.personalise_s, times.new_pose_ms.get(kind), known))
    return (*seconds, spread, scientific(row.nonlinearity))


def memory_texts(row: Row) -> tuple[str, ...]:
    """Memory, sizes and energy as text in the order of `MEMORY_TITLES`."""
    own = row.footprint
    spans = (own.memory_mb, own.train_memory_mb, own.vram_mb, own.avatar_mb)
    weights = "–" if own.weights_mb is None else three_digits(own.weights_mb)
    return (*map(duration, spans), weights, amount(own.parameters), duration(own.frame_j))


def memory_table(table: Table) -> tuple[tuple[str, ...], list[tuple[Row, tuple[str, ...]]]]:
    """Heads and rows of the table of memory, sizes and energy, without what no row tells."""
    texts = [memory_texts(row) for row in table.footprints]
    told = [i for i in range(len(MEMORY_TITLES)) if any(text[i] != "–" for text in texts)]
    rows = [(row, tuple(text[i] for i in told)) for row, text in zip(table.footprints, texts, strict=True)]
    return tuple(MEMORY_TITLES[i] for i in told), rows


def amount(value: float | None) -> str:
    """A count for reading: "512", "84 thousand", "1.2 million", "–" for none."""
    if value is None:
        return "–"
    for size, name in ((1e9, " billion"), (1e6, " million"), (1e3, " thousand")):
        if value >= size:
            scaled = value / size
            return f"{scaled:.1f}{name}" if scaled < 10 else f"{scaled:.0f}{name}"
    return f"{value:.0f}"


def scientific(value: float | None) -> str:
    """A ratio as text: "2.1e-07", "0" for zero, "–" for none."""
    if value is None:
        return "–"
    return f"{value:.1e}" if value else "0"


def moment(told: str) -> str:
    """ "2026-03-01, 14:05 UTC" of "2026-03-01T14:05:00+00:00"."""
    return f"{told[:10]}, {told[11:16]} UTC"
