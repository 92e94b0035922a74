"""The command line: argument parsing over one public function per verb. Nothing heavy is imported before it is used.

Each module of `_MODULES` adds its verbs with `add(verbs)`.
"""

from __future__ import annotations

import argparse
import atexit
import errno
import gc
import importlib
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import NoReturn

from .. import __version__
from ..errors import HandbenchError

_MODULES = ("run", "report", "gate", "catalogue", "data", "studies", "score", "audit", "metrics")


def command() -> NoReturn:
    """The process `handbench`: `main`, after which it ends at once.

    Whatever registered itself for the end is called, but the interpreter does not take torch, jax and mitsuba apart
    object by object, which was a second of each run.
    """
    code = main()
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):  # `main` has told what it could
            stream.flush()
    os._exit(code)


def main(argv: list[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 a method crashed or broke a law, 2 bad input, 130 stopped."""
    gc.set_threshold(100_000, 50, 100)  # by default 0.3 s are spent on looking through torch while it loads
    arguments = _parser().parse_args(argv)
    verb: Callable[[argparse.Namespace], int] = arguments.verb
    try:
        code = verb(arguments)
        sys.stdout.flush()  # here, where a reader that has left is known
        return code
    except HandbenchError as error:
        if os.environ.get("HANDBENCH_DEBUG"):
            raise
        print(f"handbench: {' '.join(str(error).split())}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("handbench: stopped; what was finished is kept, the same command goes on from there", file=sys.stderr)
        return 130
    except OSError as error:  # mostly of printing: files of ours have errors of their own
        if error.errno not in (errno.EPIPE, errno.ENOSPC):
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if error.errno == errno.EPIPE:  # the reader of a pipe has seen enough
            return 0
        print("handbench: a disk is full, the output is cut off; make room and try again", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="handbench", description="Benchmark hand-relighting methods.")
    parser.add_argument("--version", action="version", version=f"handbench {__version__}")
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    for name in _MODULES:
        importlib.import_module(f"{__name__}.{name}").add(verbs)
    return parser
