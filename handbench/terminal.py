"""The border to the terminal: whatever the text, nothing in it is a command to the terminal or markup.

Names, titles and error texts come from files and plug-ins of others. Everything that handbench prints goes through
`say`, `complain` or `show`.
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

_PIPED = 120  # characters
# Control characters become their pictures (ESC is "␛"), of the same width; what turns the direction of writing, or
# ends a line unseen, becomes "�".
_PICTURES = {code: 0x2400 + code for code in range(32) if chr(code) not in "\t\n"} | {0x7F: 0x2421}
_UNSEEN = (*range(0x80, 0xA0), 0x2028, 0x2029, *range(0x202A, 0x202F), *range(0x2066, 0x206A), 0x200E, 0x200F, 0x061C)
_SHOWN = _PICTURES | dict.fromkeys(_UNSEEN, 0xFFFD)


def printable(text: str) -> str:
    """A text without control characters; lines and tabs stay."""
    return text.translate(_SHOWN)


def say(text: object = "", end: str = "\n") -> None:
    """Print a text on standard output."""
    print(printable(str(text)), end=end, flush=True)


def complain(text: object) -> None:
    """Print a text on standard error."""
    print(printable(str(text)), file=sys.stderr, flush=True)


def show(renderable: RenderableType) -> None:
    """Print a rich renderable on standard output; square brackets in its texts mean themselves.

    What is piped has no width: it is written as for a wide terminal, unless COLUMNS says one.
    """
    from rich.segment import Segment, Segments

    terminal = console()
    if not terminal.is_terminal and "COLUMNS" not in os.environ:
        terminal.width = _PIPED
    segments = [Segment(printable(text), style, control) for text, style, control in terminal.render(renderable)]
    terminal.print(Segments(segments), end="")


def console(stderr: bool = False) -> Console:
    """A rich console that takes texts as they are: no markup, no emoji codes, no highlighting."""
    from rich.console import Console

    return Console(stderr=stderr, markup=False, emoji=False, highlight=False)
