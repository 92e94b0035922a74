"""Texts of others in files of ours: a title, a reason or a header is never a command, a link or a formula there."""

from __future__ import annotations

import re

from handbench.terminal import printable

LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "[": "{[}",
    "]": "{]}",
    "→": r"$\rightarrow$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "×": r"$\times$",
    "≥": r"$\geq$",
    "≠": r"$\neq$",
    "≤": r"$\leq$",
    "−": r"$-$",
    "∞": r"$\infty$",
    "τ": r"$\tau$",
    "†": r"\textdagger{}",
    "–": "--",
    "…": r"\ldots{}",
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
    """A text as LaTeX prints it."""
    return "".join(LATEX.get(letter, letter) for letter in _UNSET.sub("?", one_line(text)))


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
