"""How a command ends: its exit code and one sentence, whatever happened."""

from __future__ import annotations

import argparse
import errno
import os
import signal
import sys
from typing import TYPE_CHECKING, Any, NoReturn

from ..errors import HandbenchError
from ..terminal import complain, printable

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

BAD_INPUT, FAULT = 2, 70
CODES = (
    "exit codes: 0 done; 1 the answer is no (a regression, a broken law, a failed cell); 2 bad input, or a machine "
    "that cannot do it (a full disk, too little memory); 70 a fault of handbench itself; 128 + n stopped by signal n "
    "(130: Ctrl-C). A reader that leaves, as in '| head', changes none of them."
)
_LONGEST = 4000  # characters of a sentence: texts of others have no end


class Formatter(argparse.HelpFormatter):
    """Help in which a paragraph of several lines, such as examples, keeps them."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        filled = super()._fill_text
        paragraphs = text.strip("\n").split("\n\n")
        return "\n\n".join(each if "\n" in each else filled(each, width, indent) for each in paragraphs)


class Parser(argparse.ArgumentParser):
    """An argument parser whose messages repeat what was given without obeying it."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **{"formatter_class": Formatter, **options})

    def _print_message(self, message: str, file: SupportsWrite[str] | None = None) -> None:
        super()._print_message(printable(message), file)

    def error(self, message: str) -> NoReturn:
        super().error(_sentence(message))


def ending(error: BaseException, resumes: bool, seen: int | None) -> int:
    """The exit code of a command that ended in `error`, which one sentence on standard error tells.

    `resumes` says whether the command goes on from where it was stopped, `seen` which signal came.
    """
    if os.environ.get("HANDBENCH_DEBUG"):
        import traceback

        complain("".join(traceback.format_exception(error)))
    if isinstance(error, KeyboardInterrupt) or seen is not None:
        kept = "; what was finished is kept, the same command goes on from there" if resumes else ""
        complain(f"handbench: stopped{kept}")
        return 128 + (seen or signal.SIGINT)
    text, code = _told(error)
    complain(f"handbench: {_sentence(text)}")
    return code


def _told(error: BaseException) -> tuple[str, int]:
    if isinstance(error, HandbenchError):
        return str(error), error.exit_code
    if isinstance(error, MemoryError):
        return "there is not enough memory; close what else runs, or ask for less", BAD_INPUT
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"a disk is full{_of(error)}; make room and try again", BAD_INPUT
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename} cannot be used ({error.strerror})", BAD_INPUT
    kind = type(error).__name__
    return f"a fault of handbench itself ({kind}: {error}); {_kept(error)}", FAULT


def _of(error: OSError) -> str:
    return "" if error.filename is None else f" ({error.filename})"


def _kept(error: BaseException) -> str:
    """Where the traceback is, for a report of the fault."""
    import tempfile
    import traceback

    text = "".join(traceback.format_exception(error))
    try:
        descriptor, path = tempfile.mkstemp(prefix="handbench-fault-", suffix=".txt")
        with os.fdopen(descriptor, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"{sys.argv}\nPython {sys.version}\n{text}")
    except OSError:
        complain(text)
        return "its traceback stands above, please report it"
    return f"its traceback is in {path}, please report it"


def _sentence(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST // 2]} … {line[-_LONGEST // 2 :]}"
