"""What the documentation site shows that is not written by hand: commands from the parsers, presets from the methods'
configurations, registered names, the tutorial from its notebook. MkDocs calls `on_page_markdown` of each page.

A page asks for such a part with a line like `{{ commands }}`.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
NOTEBOOK = ROOT / "examples" / "tutorial.ipynb"
_PART = re.compile(r"^\{\{ (\w+) \}\}$", re.MULTILINE)
_OUTSIDE = re.compile(r"\[([^\]]+)\]\(\.\./[^)]+\)")  # a link to a file of the checkout, which the site does not hold


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page with its parts made, and links that lead out of the documentation as their text."""
    return _PART.sub(lambda found: PARTS[found[1]](), _OUTSIDE.sub(r"\1", markdown))


def commands() -> str:
    """Every verb with its options and examples."""
    from handbench.cli import parser

    return "\n".join(line for name, verb in verbs(parser()) for line in _command(name, verb))


def verbs(parser: argparse.ArgumentParser, above: str = "") -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """The verbs that do something, by their words."""
    inner = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    for action in inner:
        told = {choice.dest: choice.help for choice in action._choices_actions}
        for name, verb in action.choices.items():
            verb.description = verb.description or told.get(name)
            yield from verbs(verb, f"{above} {name}".strip())
    if not inner:
        yield above, parser


def _command(name: str, verb: argparse.ArgumentParser) -> Iterator[str]:
    yield f"## handbench {name}\n"
    yield f"{_sentence(verb.description or '')}\n"
    yield "| argument | what it does |\n| --- | --- |"
    for action in verb._actions:
        if action.dest != "help":
            names = ", ".join(action.option_strings) or str(action.metavar or action.dest)
            value = "" if action.nargs == 0 or not action.option_strings else f" {action.metavar or ''}".rstrip()
            yield f"| `{names}{value}` | {_cell(action.help or '')} |"
    examples, _, below = (verb.epilog or "").removeprefix("examples:\n").partition("\n\n")
    yield f"\n```\n{_dedented(examples)}\n```\n"
    if below:
        yield f"{_sentence(below)}\n"


def presets() -> str:
    """The settings of each method that has presets, one column a preset."""
    from handbench.bench.plan import make_method
    from handbench.errors import InputError
    from handbench.methods import ENTRIES
    from handbench.settings import names_in

    lines = []
    for entry in ENTRIES:
        if not entry.presets or entry.settings:
            continue
        found: dict[str, dict[str, object]] = {}
        for preset in ("smoke", "ablation", "quick", "standard", "paper", "released", "seed"):
            try:
                found[preset] = dict(names_in(make_method(entry, preset).config))
            except InputError:
                continue
        lines += [f"## {entry.name}\n", f"{_sentence(entry.summary)}\n", *_settings(found), ""]
    return "\n".join(lines)


def _settings(found: dict[str, dict[str, object]]) -> Iterator[str]:
    yield f"| setting | {' | '.join(found)} |"
    yield "| --- |" + " --- |" * len(found)
    for name in dict.fromkeys(name for of_preset in found.values() for name in of_preset):
        values = [_value(of_preset.get(name)) for of_preset in found.values()]
        yield f"| `{name}` | {' | '.join(values)} |"


def names() -> str:
    """Registered protocols, methods, metrics, captures, hands and studies, each with its line."""
    from handbench import registry

    tables = {
        "Protocols": registry.PROTOCOLS,
        "Methods": registry.METHODS,
        "Metrics": registry.METRICS,
        "Captures": registry.CAPTURES,
        "Hands": registry.HANDS,
        "Studies": registry.STUDIES,
    }
    lines = []
    for title, table in tables.items():
        lines += [f"## {title}\n", "| name | what it is |\n| --- | --- |"]
        lines += [f"| `{entry.name}` | {_cell(entry.summary)} |" for entry in table.entries().values()]
        lines.append("")
    return "\n".join(lines)


def tutorial() -> str:
    """The notebook's texts, with its code between them."""
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    shown = {"markdown": "{}\n", "code": "```python\n{}\n```\n"}
    return "\n".join(shown[cell["cell_type"]].format("".join(cell["source"])) for cell in cells)


PARTS: dict[str, Callable[[], str]] = {each.__name__: each for each in (commands, presets, names, tutorial)}


def _sentence(text: str) -> str:
    text = _plain(text).strip()
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "!")) else ".")


def _cell(text: str) -> str:
    return _plain(text).replace("|", "\\|")


def _plain(text: str) -> str:
    """A help text outside of argparse, with its signs as text."""
    return text.replace("%%", "%").replace("<", "&lt;").replace("*", "\\*")


def _dedented(text: str) -> str:
    return "\n".join(line.removeprefix("  ") for line in text.splitlines())


def _value(value: object) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(map(_value, value))
    if isinstance(value, float):
        return f"{value:.4g}"
    return "" if value is None else str(value)
