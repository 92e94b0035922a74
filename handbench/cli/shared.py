"""What several verbs need: printing, the report of a finished run, lists of names and numbers."""

from __future__ import annotations

import argparse
import importlib
from pathlib import Path
from typing import Any


def show(renderable: Any) -> None:
    from rich.console import Console

    Console().print(renderable)


def report(folder: Path) -> Path:
    """Print the table of a run, write its reports and return its page."""
    reports = importlib.import_module("handbench.reports")
    table = reports.table(folder)
    show(reports.render_terminal(table))
    page: Path = reports.write_reports(folder, table=table)["index.html"]
    return page


def names(text: str) -> tuple[str, ...]:
    found = tuple(name.strip() for name in text.split(",") if name.strip())
    if not found:
        raise argparse.ArgumentTypeError("give at least one name")
    return found


def numbers(text: str) -> tuple[int, ...]:
    try:
        found = tuple(int(number) for number in text.split(","))
    except ValueError:
        found = ()
    if not found or min(found) < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is no list of whole numbers such as 0,1,2")
    return found
