"""The command line: argument parsing over one public function per verb, and one way out of the process.

Each module of `_MODULES` adds its verbs with `add(verbs)`. Nothing is imported before it is used, so that an
interrupt finds `command` at work as early as possible.
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    import argparse
    from typing import NoReturn

    from .process import Stops

_MODULES = (
    *("run", "report", "gate", "board", "catalogue", "data", "hand", "studies", "score", "audit", "metrics"),
    *("personalise", "relight", "view", "export", "cache", "completion"),
)
_START = """\
examples:
  handbench run smoke                     seconds: is everything in place?
  handbench run quick                     train and score six methods, write the report
  handbench report runs/quick             the table again
  handbench VERB --help                   options and examples of a verb

"""


def command() -> NoReturn:
    """The process `handbench`: `main`, after which it ends at once.

    Whatever registered itself for the end is called, but the interpreter does not take torch, jax and mitsuba apart
    object by object, which was a second of each run.
    """
    import os

    code = 130
    try:
        from .process import live

        code = live(main)
    except KeyboardInterrupt:  # before there was anything to tell, or after all was told
        pass
    os._exit(code)


def main(argv: list[str] | None = None, stops: Stops | None = None) -> int:
    """Run a command and return its exit code, see `endings`; `stops` knows of a signal, whatever a library made of it.

    Raises `SystemExit` for arguments that cannot be parsed, as argparse does.
    """
    import gc

    gc.set_threshold(100_000, 50, 100)  # by default 0.3 s are spent on looking through torch while it loads
    root = parser()
    arguments = root.parse_args(argv)
    if not hasattr(arguments, "verb"):  # a bare "handbench"
        root.print_help()
        return 0
    try:
        _check_place()
        code: int = arguments.verb(arguments)
        sys.stdout.flush()
        return code
    except BaseException as error:
        from .endings import ending

        return ending(error, getattr(arguments, "resumes", False), stops.signal if stops else None)


def _check_place() -> None:
    """Raises `InputError` if the folder that the command was given in is gone: libraries ask for it in odd moments."""
    import os

    try:
        os.getcwd()  # noqa: PTH109  (pathlib is not needed otherwise)
    except OSError as error:
        from ..errors import InputError

        raise InputError("the current folder is gone; change to one that exists") from error


def parser() -> argparse.ArgumentParser:
    """The whole command line; help, completion and the command reference are made from it."""
    import importlib

    from .. import __version__
    from .endings import CODES, Parser

    root = Parser(prog="handbench", description="Benchmark hand-relighting methods.", epilog=_START + CODES)
    root.add_argument("--version", action="version", version=f"handbench {__version__}")
    verbs = root.add_subparsers(metavar="VERB")
    for name in _MODULES:
        importlib.import_module(f"{__name__}.{name}").add(verbs)
    return root
