"""handbench leaderboard: many runs as a folder of static files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..terminal import say
from .shared import examples, json_option, tell


def add(verbs: Any) -> None:
    board = verbs.add_parser("leaderboard", help="many runs as static files: standing, history, and a page for each")
    board.add_argument("out", type=Path, metavar="DIR", help="the folder to write")
    board.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="folders of runs")
    json_option(board)
    examples(board, "leaderboard site runs/*  # site/index.html, ready to be published")
    board.set_defaults(verb=_board)


def _board(arguments: argparse.Namespace) -> int:
    from ..reports.board import write_board

    page = write_board(arguments.out, arguments.runs)
    if arguments.json:
        tell({"page": str(page)})
    else:
        say(page)
    return 0
