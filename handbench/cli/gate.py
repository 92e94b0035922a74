"""handbench gate: may a candidate run replace a baseline?"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterable
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..terminal import complain, say, show
from .shared import examples, json_option, names

if TYPE_CHECKING:
    from rich.table import Table

    from ..results.outcome import Check, Outcome

_CODES = (
    "exit codes: 0 pass, 1 regression, 2 not comparable or bad input, 3 the candidate run failed, 4 too noisy to tell; "
    "others as everywhere"
)
_PERCENT = re.compile(r"(\d{1,20}(?:\.\d{1,20})?)\s*%", re.ASCII)
_AMOUNT = re.compile(r"([\w-]+)\s*=\s*(\d{1,20}(?:\.\d{1,20})?(?:e-?\d{1,3})?)", re.ASCII)
_MOST = 1e6  # a threshold above lets everything pass
_STYLES = {"regression": "bold red", "cannot tell": "magenta", "worse": "yellow", "better": "green", "same": ""}


def add(verbs: Any) -> None:
    gate = verbs.add_parser("gate", help="fail if a run is worse or slower than a baseline")
    gate.add_argument("candidate", type=Path, help="the folder of a run")
    gate.add_argument("--baseline", type=Path, required=True, metavar="RUN", help="the run to compare it with")
    gate.add_argument(
        "--quality",
        type=_quality,
        default="1%",
        metavar="1%,psnr=0.1",
        help="how much worse a metric may be: a share of the baseline's value, or amounts for single metrics (1%%)",
    )
    gate.add_argument("--time", metavar="25%", help="how much longer a frame may take, or off (default: 25%%)")
    gate.add_argument(
        "--memory", metavar="25%", default="off", help="how much more memory drawing may take, or off (default: off)"
    )
    gate.add_argument("--methods", type=names, metavar="A,B", help="instead of all measured methods of the baseline")
    json_option(gate)
    examples(
        gate,
        "gate runs/new --baseline runs/main  # 1 % in quality, 25 % in time",
        "gate runs/new --baseline runs/main --quality psnr=0.1 --time off --json",
        below=_CODES,
    )
    gate.set_defaults(verb=_gate)


def _gate(arguments: argparse.Namespace) -> int:
    from ..results.gate import Quality, gate
    from ..results.reading import read_run

    share, amounts = arguments.quality
    candidate, baseline = read_run(arguments.candidate), read_run(arguments.baseline)
    time, asked = _time(arguments.time)
    memory = None if arguments.memory == "off" else _share(arguments.memory, "memory")
    outcome = gate(candidate, baseline, Quality(share, amounts), time, asked, arguments.methods, memory)
    if arguments.json:
        say(_json(outcome))
    else:
        for place, checks in groupby(outcome.checks, key=lambda check: check.column):
            show(_table(place or "Times of a frame, and memory", checks))
        for remark in outcome.remarks:
            say(remark)
        (complain if outcome.verdict else say)(f"handbench: {outcome.sentence}")
    return int(outcome.verdict)


def _quality(text: str) -> tuple[float, dict[str, float]]:
    """ "0.5%,psnr=0.1" is (0.005, {"psnr": 0.1}); 1 % is the share unless another is given."""
    share, amounts = 0.01, {}
    for part in (piece.strip() for piece in text.split(",")):
        if (found := _percent(part)) is not None:
            share = found
        elif (given := _AMOUNT.fullmatch(part)) and float(given[2]) <= _MOST:
            amounts[given[1]] = float(given[2])
        else:
            raise argparse.ArgumentTypeError(f"{part!r} is no threshold; give a share (1%) or an amount (psnr=0.1)")
    return share, amounts


def _time(text: str | None) -> tuple[float | None, bool]:
    """The share, None for "off", and whether it was asked for."""
    if text == "off":
        return None, False
    return (0.25, False) if text is None else (_share(text), True)


def _share(text: str, what: str = "time") -> float:
    from ..errors import InputError

    found = _percent(text.strip())
    if found is None:
        raise InputError(f"{what} {text!r} is no threshold; give a share such as 25%, or off")
    return found


def _percent(text: str) -> float | None:
    """ "25%" is 0.25; None for anything else, and for a share that nothing could exceed."""
    found = _PERCENT.fullmatch(text)
    return float(found[1]) / 100 if found and float(found[1]) <= _MOST else None


def _table(title: str, checks: Iterable[Check]) -> Table:
    from rich.table import Table
    from rich.text import Text

    from ..results.record import UNEQUAL

    table = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0), header_style="dim")
    for name in ("method", "metric"):
        table.add_column(name, overflow="fold")
    for name in ("baseline", "candidate", "worse by", "allowed", "verdict"):
        table.add_column(name, justify="left" if name == "verdict" else "right", no_wrap=True)
    for check in checks:
        cells = (check.method + UNEQUAL * check.unequal, check.metric, *_numbers(check))
        table.add_row(*map(Text, cells), Text(check.verdict, style=_STYLES[check.verdict]))
    return table


def _numbers(check: Check) -> tuple[str, ...]:
    """Values, how much worse and, if that is not noise alone, its interval on a second line."""

    def worse(value: float) -> str:
        return f"{100 * value:+.1f} %" if check.kind != "quality" else f"{value:+.4g}"

    told = worse(check.worse)
    if check.verdict != "same" and check.low is not None and check.high is not None:
        told += f"\n[{worse(check.low)}, {worse(check.high)}]"
    return f"{check.baseline:.5g}", f"{check.candidate:.5g}", told, worse(check.allowed).removeprefix("+")


def _json(outcome: Outcome) -> str:
    import json
    from dataclasses import asdict

    content = {
        "verdict": outcome.verdict.name.lower().replace("_", " "),
        "exit_code": int(outcome.verdict),
        "sentence": outcome.sentence,
        "reasons": outcome.reasons,
        "remarks": outcome.remarks,
        "checks": [asdict(check) for check in outcome.checks],
    }
    return json.dumps(content, indent=1, allow_nan=False)
