"""The table as LaTeX for the booktabs package; it compiles with a plain article class."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby

from .model import UNEQUAL, UNEQUAL_NOTE, Aggregate, Column, Row, Table, bounds, chance, letter, marks, number, signed
from .safe import latex, latex_header, one_line

WIDTH = 9  # value columns that fit the text width of a plain article at \footnotesize
WIDTH_APART = 5  # columns of differences with their intervals that do


def render_latex(table: Table) -> str:
    """A `table` float for the booktabs package, folded at columns to the width of a plain article.

    Best values are bold, second best underlined; calibration and published rows each come after a rule. With a
    baseline a second float holds the differences to it, each over its interval and its p-value.
    """
    notes = [f"\\textsuperscript{{{letter(i)}}}\\,{latex(note)}." for i, note in enumerate(table.footnotes, start=1)]
    notes += [latex(remark) for remark in table.remarks]
    if table.unequal:
        notes.append(f"{latex(UNEQUAL_NOTE)}.")
    published = any(row.kind == "published" for row in table.rows)
    below = "calibration and published values" if published else "calibration"
    title = latex(table.title)
    marked = "Best in bold, second best underlined, with all that cannot be told from them"
    lines = [
        r"% needs \usepackage{booktabs}",
        *(f"% {one_line(metric.title)}: {metric.signature}" for metric in table.metrics),
        *_float(f"{title}. {marked}; below the rule, {below}.", _tabulars(table, table.rows, WIDTH, _cell), notes),
    ]
    if table.baseline:
        caption = f"{title}. Paired differences to {latex(table.baseline)}, 95\\% interval, corrected p-value."
        blocks = _tabulars(table, table.compared, WIDTH_APART, _difference)
        lines += ["", *_float(caption, blocks, [latex(limit) for limit in table.limits])]
    return "\n".join(lines) + "\n"


def _float(caption: str, blocks: Iterable[str], notes: Sequence[str]) -> Iterator[str]:
    yield r"\begin{table}[htbp]"
    yield r"  \centering\footnotesize\setlength{\tabcolsep}{3pt}"
    yield f"  \\caption{{{caption}}}"
    yield "\n\n  \\medskip\n".join(blocks)
    if notes:
        yield f"\n  \\par\\smallskip {' '.join(notes)}"
    yield r"\end{table}"


def _tabulars(table: Table, rows: Sequence[Row], width: int, text: Callable[[Aggregate, Column], str]) -> Iterator[str]:
    """One tabular for each batch of columns that fit the width."""
    for indices in _folded(table, width):
        spans = [(group, len(list(members))) for group, members in groupby(table.columns[i].group for i in indices)]
        heads = [f"\\multicolumn{{{size}}}{{c}}{{{latex(group.title)}}}" for group, size in spans]
        rules, start = [], 2
        for _, size in spans:
            rules.append(f"\\cmidrule(lr){{{start}-{start + size - 1}}}")
            start += size
        kinds = [[row for row in rows if row.kind == kind] for kind in ("method", "calibration", "published")]
        blocks = ["\n".join(_row(row, table, indices, text) for row in of_kind) for of_kind in kinds if of_kind]
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
        yield "\n".join(lines)


def _folded(table: Table, width: int) -> Iterator[list[int]]:
    """Consecutive columns that fit the width together; a group is cut only if it alone is wider."""
    batch: list[int] = []
    for group in table.groups:
        members = list(table.of_group(group))
        if batch and len(batch) + len(members) > width:
            yield batch
            batch = []
        batch += members
        while len(batch) > width:
            yield batch[:width]
            batch = batch[width:]
    if batch:
        yield batch


def _head(column: Column) -> str:
    """The metric's own header; what stands in brackets goes to a second line, to save width."""
    metric = column.metric
    head, bracket, rest = latex_header(metric.latex, f"{metric.title} {metric.arrow}").partition(" (")
    return f"\\shortstack[r]{{{head}\\\\({rest}}}" if bracket else head


def _row(row: Row, table: Table, indices: list[int], text: Callable[[Aggregate, Column], str]) -> str:
    title = latex(row.title + (row.suffix if row.kind == "published" else ""))
    if row.enrolment:
        title += f"\\,{{\\tiny {latex(row.enrolment)}}}"
    cells = [text(row.cells[index], table.columns[index]) for index in indices]
    return f"    {title} & {' & '.join(cells)} \\\\"


def _cell(cell: Aggregate, column: Column) -> str:
    value = latex(number(cell.value, column.metric.decimals))
    value = {0: value, 1: f"\\textbf{{{value}}}", 2: f"\\underline{{{value}}}"}[cell.rank] + latex(
        UNEQUAL
    ) * cell.unequal
    gap = "" if cell.complete else f"\\,{{\\tiny {cell.covered}/{cell.expected}}}"
    return value + gap + (f"\\textsuperscript{{{marks(cell)}}}" if cell.notes else "")


def _difference(cell: Aggregate, column: Column) -> str:
    """The difference, its interval and its p-value, one over the other."""
    apart, decimals = cell.difference, column.metric.decimals
    if apart is None:
        return "--"
    below = [f"\\tiny {latex(text)}" for text in (bounds(apart, decimals), chance(apart)) if text]
    lines = r"\\".join([latex(signed(apart.value, decimals)) + latex(UNEQUAL) * cell.across, *below])
    return f"\\shortstack[r]{{{lines}}}"
