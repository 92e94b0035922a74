"""Texts of others in files of ours: a title, a reason or a header is never a command, a link or a formula there."""

from __future__ import annotations

import re
from functools import lru_cache

from handbench.terminal import printable

from .texletters import encoder, guarded, is_plain

_LATEX = {  # as texts are set, where pylatexenc would say it otherwise; brackets could become an argument
    "[": "{[}",
    "]": "{]}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "–": "--",
    "−": "$-$",
    "×": r"$\times$",
    "\xa0": "~",
}
_UNSET = re.compile("[\u2400-\u2421\ufffd]")  # what stands for control characters, which LaTeX's fonts do not have
_MARKDOWN = {**{sign: f"\\{sign}" for sign in "\\|*[]`"}, "<": "&lt;"}
# What a metric's own LaTeX may hold: letters, signs without a meaning, $ ^ _ { } and these commands.
_PLAIN = re.compile(r"[A-Za-z0-9 .,:;()/+=$^_{}\\'-]*")
_COMMANDS = frozenset(
    {
        *("uparrow", "downarrow", "circ", "cdot", "times", "pm", "infty", "ell", "Delta", "Sigma", "Omega"),
        *("alpha", "beta", "gamma", "delta", "epsilon", "varepsilon", "theta", "kappa", "lambda", "mu", "rho", "sigma"),
        *("tau", "phi", "omega", "mathrm", "mathit", "mathbf", "mathcal", "text", "textit", "textbf", "textsc", "emph"),
    }
)


def one_line(text: str) -> str:
    """A text without line breaks and control characters."""
    return " ".join(printable(text).split())


def latex(text: str) -> str:
    """A text as LaTeX prints it, in ASCII."""
    return "".join(map(_latex_letter, _UNSET.sub("?", one_line(text))))


@lru_cache(maxsize=4096)
def _latex_letter(letter: str) -> str:
    if letter in _LATEX:
        return _LATEX[letter]
    return str(encoder().unicode_to_latex(letter)) if letter.isascii() or is_plain(letter) else guarded(letter)


def latex_header(given: str, title: str) -> str:
    """A metric's own LaTeX, or its title if that holds more than letters, formulas and harmless commands."""
    commands = re.findall(r"\\([A-Za-z]+|.|$)", given)
    fine = _PLAIN.fullmatch(given) and "^^" not in given and _COMMANDS.issuperset(commands)
    return given if fine and given.count("$") % 2 == 0 and _balanced(given) else latex(title)


def _balanced(text: str) -> bool:
    depth = 0
    for letter in text:
        depth += (letter == "{") - (letter == "}")
        if depth < 0:
            return False
    return depth == 0


def markdown(text: str) -> str:
    """A text inside a line of Markdown."""
    return "".join(_MARKDOWN.get(letter, letter) for letter in one_line(text))


def csv_cell(value: object) -> object:
    """A value for a CSV file; a text that a spreadsheet would take for a formula gets an apostrophe before it."""
    return f"'{value}" if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")) else value
