"""What several verbs need: the report of a finished run, and what their options may be."""

from __future__ import annotations

import argparse
from pathlib import Path

_LARGEST_SEED = 2**63 - 1  # what databases and random generators take


def report(folder: Path) -> Path:
    """Write the reports of a run, then print its table, and return its page."""
    from .. import reports
    from ..terminal import show

    table = reports.table(folder)
    page: Path = reports.write_reports(folder, table=table)["index.html"]
    show(reports.render_terminal(table))
    return page


def names(text: str) -> tuple[str, ...]:
    found = tuple(name.strip() for name in text.split(",") if name.strip())
    if not found:
        raise argparse.ArgumentTypeError("give at least one name")
    return found


def preset(text: str) -> str:
    if not text.strip():
        raise argparse.ArgumentTypeError("a preset has a name; leave the option out for the protocol's")
    return text


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
