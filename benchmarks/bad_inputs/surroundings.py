"""What a process finds around it: encodings, streams that are closed or full, signals, missing folders."""

from __future__ import annotations

import random

from .bases import Bases
from .case import BadInput

_VERBS = (
    "list metrics",
    "run quik",
    "report RUN",
    "query RUN 'SELECT 1 AS \"↑ü\"'",
    "gate RUN --baseline RUN",
    "--help",
)
_VERBS += ("list nonsense", "report /dev/null", "report $'\\xff\\e[31m'", "gate RUN --baseline RUN --json")
_STREAMS = ("{}", "{} | true", "{} | head -1", "{} >/dev/full", "{} >&-", "{} 2>&-", "{} >&- 2>&-", "{} 2>/dev/full")
_STREAMS += ("{} <&-", "{} <&- >&- 2>&-", "{} >/dev/full 2>&1", "(ulimit -f 0; {} > file)", "(ulimit -n 16; {})")
_STREAMS += (
    "timeout -s INT 0.4 {}",
    "timeout -s TERM 0.6 {}",
    "timeout -s HUP 0.5 {}",
    "(cd gone && rmdir ../gone && {})",
)
_ENVIRONMENTS: tuple[dict[str, str], ...] = (
    {},
    {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    {"PYTHONIOENCODING": "ascii"},
    {"PYTHONIOENCODING": "latin-1:strict"},
    {"LANG": "no_SUCH"},
    {"COLUMNS": "1"},
    {"COLUMNS": "nonsense", "LINES": "-1"},
    {"TERM": "dumb", "FORCE_COLOR": "1"},
    {"HANDBENCH_DATA": "/dev/null"},
    {"HOME": "/nowhere"},
    {"TMPDIR": "/nowhere"},
    {"HANDBENCH_DEBUG": ""},
    {"OMP_NUM_THREADS": "0"},
    {"PYTHONUNBUFFERED": "1"},
)
_CODES = frozenset({0, 1, 2, 3, 124, 129, 130, 143})


def surroundings(rng: random.Random, bases: Bases) -> BadInput:
    """A verb in a process of its own, in odd surroundings."""
    verb, stream, around = rng.choice(_VERBS), rng.choice(_STREAMS), rng.choice(_ENVIRONMENTS)
    line = stream.format(f"$H {verb.replace('RUN', str(bases.run))}")
    return BadInput(
        "surroundings",
        f"{verb.split()[0]} {stream}",
        (),
        None,
        special="mkdir gone",
        process=(line,),
        environment=around,
        codes=_CODES,
    )
