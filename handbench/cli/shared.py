"""What several verbs need: the report of a finished run, and what their options may be."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..terminal import say

if TYPE_CHECKING:
    from ..bench.protocol import Protocol
    from ..bench.run import RunSummary
    from ..registry import Entry
    from ..settings import Setting

_LARGEST_SEED = 2**63 - 1  # what databases and random generators take


def examples(verb: argparse.ArgumentParser, *commands: str, below: str = "") -> None:
    """Put examples below the help of a verb, each a command with "  # what it does" behind it, and a paragraph more."""
    lines = [command.partition("  # ") for command in commands]
    width = max(len(command) for command, _, _ in lines)
    told = [f"  handbench {command:<{width}}  {what}".rstrip() for command, _, what in lines]
    verb.epilog = "\n".join(["examples:", *told]) + (f"\n\n{below}" if below else "")


def protocol_options(verb: argparse.ArgumentParser) -> None:
    """Which protocol, how much of it, and where its data are."""
    verb.add_argument("protocol", help="a name that 'handbench list protocols' shows, or a TOML file")
    verb.add_argument(
        "--subjects", type=names, metavar="S,T", help="score only these subjects; training stays as it is"
    )
    verb.add_argument("--limit", type=count, metavar="N", help="score at most N frames of each column")
    data_option(verb)


def data_option(verb: argparse.ArgumentParser) -> None:
    verb.add_argument("--data", type=Path, metavar="DIR", help="where captures are kept")


def methods_option(verb: argparse.ArgumentParser, instead_of: str) -> None:
    told = f"names, patterns ('urhand*') or files (./mine.py), instead of {instead_of}"
    verb.add_argument("--methods", type=names, metavar="A,B", help=told)


def setting_options(verb: argparse.ArgumentParser) -> None:
    """A preset for all methods, and changes of single settings."""
    verb.add_argument("--preset", type=preset, metavar="NAME", help="one preset for all methods")
    told = "change a setting of the methods that have it, or of some: urhand:steps=500; 'handbench settings' lists them"
    verb.add_argument("--set", dest="settings", type=setting, action="append", default=[], metavar="NAME=X", help=told)


def json_option(verb: argparse.ArgumentParser) -> None:
    verb.add_argument("--json", action="store_true", help="print the answer as JSON, and nothing else")


def tell(value: Any) -> None:
    """Print an answer as JSON."""
    say(json.dumps(value, indent=1, allow_nan=False))


def chosen_protocol(arguments: argparse.Namespace) -> Protocol:
    """The protocol of `protocol_options`, narrowed as they say."""
    from ..bench.narrowing import narrowed
    from ..bench.run import find_protocol

    return narrowed(find_protocol(arguments.protocol), arguments.subjects, arguments.limit)


def chosen_methods(texts: Sequence[str] | None) -> tuple[tuple[str, ...] | None, tuple[Entry, ...]]:
    """The methods of `methods_option`, and those of them that are not registered."""
    if texts is None:
        return None, ()
    from ..bench.naming import named_methods

    return named_methods(texts)


def report(folder: Path, quiet: bool = False) -> Path:
    """Write the reports of a run, then print its table, unless it is `quiet`, and return its page."""
    from .. import reports
    from ..terminal import show

    table = reports.table(folder)
    page: Path = reports.write_reports(folder, table=table)["index.html"]
    if not quiet:
        show(reports.render_terminal(table))
    return page


def outcome_json(outcome: RunSummary, page: Path | None) -> dict[str, Any]:
    """What a run did, as JSON values."""
    told = {"folder": str(outcome.folder), "report": None if page is None else str(page)}
    lists = {name: list(getattr(outcome, name)) for name in ("crashed", "missing", "refused")}
    return {**told, "computed": outcome.computed, "reused": outcome.reused, **lists}


def names(text: str) -> tuple[str, ...]:
    found = tuple(name.strip() for name in text.split(",") if name.strip())
    if not found:
        raise argparse.ArgumentTypeError("give at least one name")
    return found


def preset(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError("a preset has a name; leave the option out for the protocol's")
    return text


def setting(text: str) -> Setting:
    from ..errors import InputError
    from ..settings import Setting

    try:
        return Setting.parse(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def count(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 10 and int(text)):
        raise argparse.ArgumentTypeError(f"{text!r} is no count; give a whole number, 1 or more")
    return int(text)


def seed(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 20 and int(text) <= _LARGEST_SEED):
        raise argparse.ArgumentTypeError(f"{text!r} is no seed; give a whole number from 0 to {_LARGEST_SEED}")
    return int(text)


def cores(text: str) -> int:
    if not (text.isascii() and text.isdigit() and int(text)):
        raise argparse.ArgumentTypeError(f"{text!r} is no number of cores; give 1 or more")
    return int(text)


def port(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 6 and int(text) < 65536):
        raise argparse.ArgumentTypeError(f"{text!r} is no port; give 1 to 65535, or 0 for any that is free")
    return int(text)


def numbers(text: str) -> tuple[int, ...]:
    return tuple(seed(number.strip()) for number in text.split(","))
