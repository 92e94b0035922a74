"""The command line: argument parsing over one public function per verb. Nothing heavy is imported before it is used.

Each module of `_MODULES` adds its verbs with `add(verbs)`.
"""

from __future__ import annotations

import argparse
import gc
import importlib
import os
import sys
from collections.abc import Callable

from .. import __version__
from ..errors import HandbenchError

_MODULES = ("run", "report", "gate", "catalogue", "data", "studies", "score", "audit", "metrics")


def main(argv: list[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 a method crashed or broke a law, 2 bad input, 130 stopped."""
    gc.set_threshold(100_000, 50, 100)  # by default 0.3 s are spent on looking through torch while it loads
    arguments = _parser().parse_args(argv)
    verb: Callable[[argparse.Namespace], int] = arguments.verb
    try:
        return verb(arguments)
    except HandbenchError as error:
        if os.environ.get("HANDBENCH_DEBUG"):
            raise
        print(f"handbench: {' '.join(str(error).split())}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("handbench: stopped; what was finished is kept, the same command goes on from there", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of a pipe has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="handbench", description="Benchmark hand-relighting methods.")
    parser.add_argument("--version", action="version", version=f"handbench {__version__}")
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    for name in _MODULES:
        importlib.import_module(f"{__name__}.{name}").add(verbs)
    return parser
