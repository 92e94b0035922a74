"""handbench completion: a script with which a shell completes verbs, options, names and files."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..terminal import say
from .shared import examples

_SHELLS = ("bash", "zsh", "tcsh")


def add(verbs: Any) -> None:
    completion = verbs.add_parser("completion", help="print a script that completes commands in a shell")
    completion.add_argument("shell", choices=_SHELLS, help="whose script")
    examples(
        completion,
        "completion bash > ~/.local/share/bash-completion/completions/handbench  # for new shells",
        "completion zsh > ~/.zfunc/_handbench  # a folder of $fpath",
        below="Names of plug-ins are those that are installed now; print the script again after installing others.",
    )
    completion.set_defaults(verb=_completion)


def _completion(arguments: argparse.Namespace) -> int:
    import shtab

    from . import parser

    root = parser()
    for action in _actions(root):
        if action.type is Path:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
        elif known := _names(action.dest):
            action.choices = known
    say(shtab.complete(root, arguments.shell), end="")
    return 0


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """The options and arguments of a parser and of all its verbs."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for verb in action.choices.values():
                yield from _actions(verb)
        else:
            yield action


def _names(option: str) -> list[str]:
    """The names that an argument takes, [] if it takes none."""
    from .. import registry

    tables = {"protocol": registry.PROTOCOLS, "capture": registry.CAPTURES}
    tables |= dict.fromkeys(("method", "methods", "baseline_method"), registry.METHODS)
    return list(tables[option].entries()) if option in tables else []
