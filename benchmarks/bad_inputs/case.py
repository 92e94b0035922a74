"""A bad input, what came of it, and the verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

CODES = {0, 1, 2, 3, 130}
LONGEST = 12_000  # characters of all that a refusal prints
VERDICTS = ("answered", "refused", "traceback", "hang", "died", "wrong", "mute")
BAD = VERDICTS[2:]


@dataclass(frozen=True)
class CommandResult:
    """What a command gave: its exit code (None: it hung or died), what it printed, and how it was lost if it was."""

    code: int | None
    out: str = ""
    err: str = ""
    lost: str = ""


@dataclass(frozen=True)
class BadInput:
    """One bad input. `words` is a command line, or a call of the worker's ("call:NAME", PATH); `right` tells of what
    was printed whether it is the right answer, where one is known: a refusal is right too."""

    family: str
    name: str
    words: tuple[str, ...]
    right: Callable[[str], bool] | None = None
    files: dict[str, bytes] = field(default_factory=dict)  # in the folder that it is tried in
    tree: tuple[str, Path] | None = None  # the name of a folder that is a copy of a sound one, below the files
    special: str = ""  # a shell's line that makes what is no regular file
    process: tuple[str, ...] = ()  # a shell's command line, for what needs a process of its own
    environment: dict[str, str] = field(default_factory=dict)
    codes: frozenset[int] = frozenset(CODES)


def verdict(case: BadInput, answer: CommandResult) -> str:
    """One of `VERDICTS`: those of `BAD` are faults of handbench."""
    if answer.lost:
        return answer.lost
    if "Traceback (most recent call last)" in answer.err + answer.out or answer.code == 70:
        return "traceback"
    if answer.code not in case.codes:
        return "died"
    if answer.code == 0:
        return "answered" if case.right is None or case.right(answer.out) else "wrong"
    silent = not (answer.err + answer.out).strip() and not case.process
    return "mute" if silent or len(answer.err) > LONGEST else "refused"
