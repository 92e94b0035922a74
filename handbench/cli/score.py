"""handbench score: pictures that a method drew elsewhere, in the tables of a protocol."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..terminal import complain, say
from .shared import chosen_protocol, examples, json_option, outcome_json, protocol_options, report, tell


def add(verbs: Any) -> None:
    score = verbs.add_parser("score", help="score a folder of pictures that a method drew elsewhere")
    protocol_options(score)
    what = score.add_mutually_exclusive_group(required=True)
    what.add_argument("folder", nargs="?", type=Path, help="the prediction folder")
    what.add_argument("--template", type=Path, metavar="DIR", help="write what is asked into a new folder instead")
    score.add_argument("--images", action="store_true", help="with --template: the pictures to train on, too")
    score.add_argument("--out", type=Path, metavar="DIR", help="run folder (default: runs/PROTOCOL-NAME)")
    score.add_argument("--name", help="the method's name in the run (default: as its manifest says)")
    score.add_argument(
        "--allow-missing", action="store_true", help="score what is there; the rest is told as missing, with reasons"
    )
    json_option(score)
    examples(
        score,
        "score smoke --template theirs  # what is asked, and a manifest to complete",
        "score smoke theirs  # check the pictures, score them, write a report",
        "score smoke theirs --allow-missing --name theirs-2",
    )
    score.set_defaults(verb=_score, resumes=True)


def _score(arguments: argparse.Namespace) -> int:
    from ..bench.score import score, template
    from ..data.predictions import Unfit
    from ..data.predictions.manifest import METHOD_NAME
    from ..files import check_folder

    _check_company(arguments)
    protocol = chosen_protocol(arguments)
    if arguments.template is not None:
        check_folder(arguments.template, "name a new folder")
        count = template(protocol, arguments.template, arguments.data, arguments.images)
        if arguments.json:
            tell({"asked": count, "folder": str(arguments.template)})
            return 0
        say(f"{count} pictures are asked for, see {arguments.template / 'asked' / 'queries.json'}")
        say(
            f"draw them, complete {arguments.template / 'manifest.json'} (method: {METHOD_NAME}; title: what tables "
            "call the row), and score the folder"
        )
        return 0
    command = ["handbench", *sys.argv[1:]]
    chosen = (arguments.out, arguments.data, arguments.name, arguments.allow_missing)
    try:
        outcome = score(protocol, arguments.folder, *chosen, command)
    except Unfit as error:
        complain("\n".join(error.lines))
        raise
    page = report(outcome.folder, quiet=arguments.json)
    if arguments.json:
        tell(outcome_json(outcome, page))
    else:
        say(f"run folder: {outcome.folder}")
        say(f"report: {page}")
    for crash in outcome.crashed:
        complain(f"handbench: {crash}")
    return 1 if outcome.crashed else 0


def _check_company(arguments: argparse.Namespace) -> None:
    """Raises `InputError` for an option that means nothing beside the others."""
    if arguments.template is None:
        if arguments.images:
            raise InputError("--images goes with --template; leave it out")
        return
    for option in ("out", "name", "allow_missing"):
        if getattr(arguments, option):
            flag = option.replace("_", "-")
            raise InputError(f"--{flag} goes with a prediction folder, not with --template; leave it out")
