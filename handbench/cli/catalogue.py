"""handbench list and handbench settings: what can be named, and what can be set."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from ..terminal import say
from .shared import examples, json_option, preset, tell

_KINDS = ("protocols", "methods", "metrics", "captures", "hands", "studies")


def add(verbs: Any) -> None:
    lists = verbs.add_parser("list", help="what can be named: protocols, methods, metrics, captures, hands, studies")
    lists.add_argument("kind", nargs="?", choices=_KINDS, help="only these")
    json_option(lists)
    examples(lists, "list", "list methods", "list protocols --json")
    lists.set_defaults(verb=_list)

    settings = verbs.add_parser("settings", help="the settings of a method, with their values at a preset")
    settings.add_argument("method", help="a name that 'handbench list methods' shows, or a file (./mine.py)")
    settings.add_argument(
        "--preset", type=preset, default="quick", metavar="NAME", help="whose values (default: quick)"
    )
    json_option(settings)
    examples(
        settings,
        "settings urhand",
        "settings urhand --preset paper",
        below="Change one with: handbench run PROTOCOL --set NAME=VALUE.",
    )
    settings.set_defaults(verb=_settings)


def _list(arguments: argparse.Namespace) -> int:
    from .. import registry

    tables = {
        "protocols": registry.PROTOCOLS,
        "methods": registry.METHODS,
        "metrics": registry.METRICS,
        "captures": registry.CAPTURES,
        "hands": registry.HANDS,
        "studies": registry.STUDIES,
    }
    kinds = [arguments.kind] if arguments.kind else list(_KINDS)
    if arguments.json:
        tell({kind: {name: entry.summary for name, entry in tables[kind].entries().items()} for kind in kinds})
        return 0
    for kind in kinds:
        entries = tables[kind].entries().values()
        width = max((len(entry.name) for entry in entries), default=0)
        say(kind)
        for entry in entries:
            say(f"  {entry.name:<{width}}  {entry.summary}")
    return 0


def _settings(arguments: argparse.Namespace) -> int:
    from ..bench.changes import settable
    from ..bench.naming import named_methods
    from ..bench.plan import make_method, method_entries
    from ..settings import names_in

    names, extra = named_methods((arguments.method,))
    entries = method_entries(names, extra)
    presets = dict.fromkeys(names, arguments.preset)
    changeable = settable(entries, presets)
    told = {name: dict(names_in(make_method(entry, presets[name]).config)) for name, entry in entries.items()}
    if arguments.json:
        tell({name: {"set": name in changeable, "settings": settings} for name, settings in told.items()})
        return 0
    for name, settings in told.items():
        say(f"{name} at preset {arguments.preset}" + ("" if name in changeable else " (not to be changed with --set)"))
        width = max(map(len, settings), default=0)
        for setting, value in settings.items():
            say(f"  {setting:<{width}}  {_text(value)}")
    return 0


def _text(value: object) -> str:
    """A value as --set takes it."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ",".join(map(_text, value))
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)
