"""The table as LaTeX for the booktabs package; it compiles with a plain article class."""

from __future__ import annotations

from collections.abc import Iterator

from .model import Cell, Column, Group, Row, Table, letter, marks, number

WIDTH = 9  # value columns that fit the text width of a plain article at \footnotesize
SPECIAL = {
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
    "→": r"$\rightarrow$",
    "×": r"$\times$",
    "≥": r"$\geq$",
    "≤": r"$\leq$",
    "−": r"$-$",
    "∞": r"$\infty$",
    "τ": r"$\tau$",
    "†": r"\textdagger{}",
    "–": "--",
    "…": r"\ldots{}",
}


def render_latex(table: Table) -> str:
    """A `table` float for the booktabs package, folded at column groups to the width of a plain article.

    Best values are bold, second best underlined; calibration and published rows each come after a rule.
    """
    blocks = "\n\n  \\medskip\n".join(_tabular(table, groups) for groups in _folded(table))
    notes = [f"\\textsuperscript{{{letter(i)}}}\\,{_escape(note)}." for i, note in enumerate(table.footnotes, start=1)]
    notes += [_escape(remark) for remark in table.remarks]
    below = "calibration and published values" if table.remarks else "calibration"
    caption = f"{_escape(table.title)}. Best in bold, second best underlined; below the rule, {below}."
    lines = [
        r"% needs \usepackage{booktabs}",
        *(f"% {metric.title}: {metric.signature}" for metric in table.metrics),
        r"\begin{table}[htbp]",
        r"  \centering\footnotesize\setlength{\tabcolsep}{3pt}",
        f"  \\caption{{{caption}}}",
        blocks,
        *(["", f"  \\par\\smallskip {' '.join(notes)}"] if notes else []),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def _tabular(table: Table, groups: tuple[Group, ...]) -> str:
    spans = [table.of_group(group) for group in groups]
    indices = [index for span in spans for index in span]
    heads = [
        f"\\multicolumn{{{len(span)}}}{{c}}{{{_escape(group.title)}}}"
        for group, span in zip(groups, spans, strict=True)
    ]
    rules, start = [], 2
    for span in spans:
        rules.append(f"\\cmidrule(lr){{{start}-{start + len(span) - 1}}}")
        start += len(span)
    kinds = [[row for row in table.rows if row.kind == kind] for kind in ("method", "calibration", "published")]
    blocks = ["\n".join(_row(row, table, indices) for row in rows) for rows in kinds if rows]
    lines = [
        f"  \\begin{{tabular}}{{l{'r' * len(indices)}}}",
        r"    \toprule",
        f"    & {' & '.join(heads)} \\\\",
        f"    {' '.join(rules)}",
        f"    Method & {' & '.join(_head(table.columns[index]) for index in indices)} \\\\",
        r"    \midrule",
        "\n    \\midrule\n".join(blocks),
        r"    \bottomrule",
        r"  \end{tabular}",
    ]
    return "\n".join(lines)


def _folded(table: Table) -> Iterator[tuple[Group, ...]]:
    """Consecutive groups whose columns fit the width together; a group that alone is wider stays whole."""
    batch: list[Group] = []
    used = 0
    for group in table.groups:
        width = len(table.of_group(group))
        if batch and used + width > WIDTH:
            yield tuple(batch)
            batch, used = [], 0
        batch.append(group)
        used += width
    yield tuple(batch)


def _head(column: Column) -> str:
    """The metric's own header; what stands in brackets goes to a second line, to save width."""
    head, bracket, rest = column.metric.latex.partition(" (")
    return f"\\shortstack[r]{{{head}\\\\({rest}}}" if bracket else head


def _row(row: Row, table: Table, indices: list[int]) -> str:
    title = _escape(row.title + (row.suffix if row.kind == "published" else ""))
    cells = [_cell(row.cells[index], table.columns[index]) for index in indices]
    return f"    {title} & {' & '.join(cells)} \\\\"


def _cell(cell: Cell, column: Column) -> str:
    value = _escape(number(cell.value, column.metric.decimals))
    value = {0: value, 1: f"\\textbf{{{value}}}", 2: f"\\underline{{{value}}}"}[cell.rank]
    return value + (f"\\textsuperscript{{{marks(cell)}}}" if cell.notes else "")


def _escape(text: str) -> str:
    return "".join(SPECIAL.get(character, character) for character in text)
