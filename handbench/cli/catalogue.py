"""handbench list: what can be named."""

from __future__ import annotations

import argparse
from typing import Any

from ..terminal import say

_KINDS = ("protocols", "methods", "metrics", "captures", "studies")


def add(verbs: Any) -> None:
    lists = verbs.add_parser("list", help="what can be named: protocols, methods, metrics, captures, studies")
    lists.add_argument("kind", nargs="?", choices=_KINDS)
    lists.set_defaults(verb=_list)


def _list(arguments: argparse.Namespace) -> int:
    from .. import registry

    tables = {
        "protocols": registry.PROTOCOLS,
        "methods": registry.METHODS,
        "metrics": registry.METRICS,
        "captures": registry.CAPTURES,
        "studies": registry.STUDIES,
    }
    for kind in [arguments.kind] if arguments.kind else _KINDS:
        entries = tables[kind].entries().values()
        width = max((len(entry.name) for entry in entries), default=0)
        say(kind)
        for entry in entries:
            say(f"  {entry.name:<{width}}  {entry.summary}")
    return 0
