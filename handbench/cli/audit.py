"""handbench audit: doubt about a finished run, check by check."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..studies import SUMMARIES
from ..terminal import complain, say
from .shared import data_option, examples, json_option, tell


def add(verbs: Any) -> None:
    audit = verbs.add_parser("audit", help=SUMMARIES["audit"])
    audit.add_argument("run", type=Path, help="the folder of a run")
    audit.add_argument("--protocol", metavar="FILE", help="the run's protocol file, if it is not a registered one")
    data_option(audit)
    json_option(audit)
    examples(audit, "audit runs/quick", "audit runs/mine --protocol mine.toml --json")
    audit.set_defaults(verb=_audit)


def _audit(arguments: argparse.Namespace) -> int:
    from ..errors import StorageError
    from ..registry import STUDIES
    from ..reports import table
    from ..results.reading import read_run
    from ..studies.auditrecord import Found, keep_audit

    words = {True: "holds", False: "BROKEN", None: "n/a"}
    verdicts = []
    for verdict in STUDIES.load("audit")(arguments.run, table, arguments.protocol, arguments.data):
        verdicts.append(verdict)
        if not arguments.json:
            say(f"{verdict.law:<22} {words[verdict.holds]:<7} {verdict.detail}")
    if arguments.json:
        told = [{"check": v.law, "verdict": words[v.holds], "detail": v.detail} for v in verdicts]
        tell(told)
    try:
        keep_audit(read_run(arguments.run), [Found(v.law, v.holds, v.detail) for v in verdicts])
    except StorageError as error:  # a stranger's folder may be one that is only read
        complain(f"handbench: {error}; reports will not tell of this audit")
    return 1 if any(verdict.holds is False for verdict in verdicts) else 0
