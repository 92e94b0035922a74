"""The table as LaTeX for the booktabs package: one row a method, in a float for one column or for both."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from .latexcells import (
    SUNK,
    TINY,
    CellText,
    column_head,
    difference_bounds,
    interval_text,
    row_name,
    starred_difference,
    text_width,
    value_text,
)
from .model import MetricColumn, Row, Table
from .printed import (
    COST_TITLES,
    UNEQUAL_NOTE,
    cost_texts,
    costs_title,
    letter,
)
from .safe import latex, one_line
from .style import PLAIN, Style
from .texletters import GUARD

_STARRED = r"* $p<0.05$, ** $p<0.01$, *** $p<0.001$, corrected over the methods of a column (Holm)."
_POINT = 72.27  # in an inch
_TALL = 520.0  # points that a float may be high: a page of article has 550
_LEADING = 10.5  # from line to line at \footnotesize, with a share of the rules
_GAP = 8.0  # points between columns: twice \tabcolsep


@dataclass(frozen=True)
class _Block:
    """What stands in the cells of a float: a text, and one below it in small print, or None for a single line."""

    rows: tuple[Row, ...]
    text: CellText
    below: CellText | None = None


def render_latex(table: Table, style: Style = PLAIN) -> str:
    """A float for the booktabs package, folded at columns to the width that `style` tells.

    Best values are bold, second best underlined; calibration and published rows each come after a rule. With a
    baseline a second float holds the measured methods' differences to it, with stars for corrected p-values. It
    compiles with pdfLaTeX and LuaLaTeX, whatever names hold: a letter that a font lacks stands as its code.
    """
    notes = _notes(table)
    table = _named(style.rounded(table))
    title = latex(style.caption) if style.caption else latex(table.title)
    values = _Block(table.rows, value_text(style), interval_text if style.intervals else None)
    tabulars = [*_tabulars(table, values, style), *(_costs(table, style) if style.times else ())]
    floats = list(_floats(style, title, _caption(table, title, style), style.label, tabulars, notes))
    if table.baseline:
        measured = tuple(row for row in table.compared if row.kind == "method")
        apart_from = f"{title}: differences to {latex(table.baseline)}"
        caption = f"{apart_from}, paired by frame and seed. {_STARRED}"
        apart = _Block(measured, starred_difference, difference_bounds if style.intervals else None)
        label = f"{style.label}-differences" if style.label else ""
        limits = [latex(limit) for limit in table.limits]
        floats += _floats(style, apart_from, caption, label, list(_tabulars(table, apart, style)), limits)
    text = "\n\n".join("\n".join(lines) for lines in floats)
    head = [r"% needs \usepackage{booktabs}", *(f"% {one_line(m.title)}: {m.signature}" for m in table.metrics)]
    guard = [GUARD] if r"\hbletter" in text else []
    return "\n".join([*head, *guard, text]) + "\n"


def _caption(table: Table, title: str, style: Style) -> str:
    published = any(row.kind == "published" for row in table.rows)
    calibration = any(row.kind == "calibration" for row in table.rows)
    below = " and ".join(
        word for word, there in (("calibration", calibration), ("published values", published)) if there
    )
    parts = [f"{title}. Best in bold, second best underlined, with all that cannot be told from them"]
    parts += [f"below the rule, {below}"] if below else []
    parts += [r"small figures are 95\,\% intervals"] if style.intervals else []
    parts += [r"after $\pm$ the standard deviation over seeds"] if style.seeds else []
    return "; ".join(parts) + "."


def _notes(table: Table) -> list[str]:
    notes = [f"\\textsuperscript{{{letter(i)}}}\\,{latex(note)}." for i, note in enumerate(table.footnotes, start=1)]
    if len(_enrolments(table)) == 1 and (given := _enrolments(table)[0]):
        notes.append(f"Enrolment gave every method: {latex(given)}.")
    notes += [latex(remark) for remark in table.remarks]
    if table.unclaimed:
        notes.append(r"\textsuperscript{$\circ$}\,holds for these hands, cannot be claimed for others (paired test).")
    if table.sunk:
        notes.append(f"\\textsuperscript{{{SUNK}}}\\,not better than the floor, so never best.")
    return notes + ([f"{latex(UNEQUAL_NOTE)}."] if table.unequal else [])


def _floats(
    style: Style, title: str, caption: str, label: str, tabulars: Sequence[str], notes: Sequence[str]
) -> Iterator[Iterator[str]]:
    """One float, or as many as pages hold: those that go on have the first one's number."""
    batches: list[list[str]] = [[]]
    below = _LEADING * _lines_of(" ".join(notes), style)  # of the notes under the last tabular
    free = _TALL - _LEADING * _lines_of(caption, style)
    for place, tabular in enumerate(tabulars, start=1):
        free -= _high(tabular)
        if batches[-1] and free < (below if place == len(tabulars) else 0.0):
            batches.append([])
            free = _TALL - _high(tabular) - 2 * _LEADING
        batches[-1].append(tabular)
    for batch in batches:
        first, last = batch is batches[0], batch is batches[-1]
        text = caption if first else f"{title} (continued)."
        yield _float(style, text, label if first else "", batch, notes if last else (), goes_on=not first)


def _lines_of(text: str, style: Style) -> float:
    """About how many lines a text fills at \\footnotesize; a caption is larger."""
    return text_width(text) / (0.8 * style.inches * _POINT)


def _high(tabular: str) -> float:
    """About how many points high a tabular is, with what separates it from the next."""
    return _LEADING * (tabular.count(r"\\") + 2)


def _float(
    style: Style, caption: str, label: str, tabulars: Sequence[str], notes: Sequence[str], goes_on: bool
) -> Iterator[str]:
    name = "table*" if style.wide else "table"
    yield f"\\begin{{{name}}}[tbp]"
    yield r"  \centering\footnotesize\setlength{\tabcolsep}{4pt}"
    if goes_on:
        yield "  \\addtocounter{table}{-1}"
    yield f"  \\caption{{{caption}}}\\smallskip"
    if label:
        yield f"  \\label{{{label}}}"
    yield "\n\n  \\medskip\n".join(tabulars)
    if notes:
        yield f"\n  \\par\\smallskip\\parbox{{\\linewidth}}{{\\raggedright {' '.join(notes)}}}"
    yield f"\\end{{{name}}}"


def _tabulars(table: Table, block: _Block, style: Style) -> Iterator[str]:
    """One tabular for each batch of columns that fit the width."""
    for indices in _folded(table, block, style.inches * _POINT):
        spans = [(group, len(list(members))) for group, members in groupby(table.columns[i].group for i in indices)]
        heads = [f"\\multicolumn{{{size}}}{{c}}{{{latex(group.title)}}}" for group, size in spans]
        rules, start = [], 2
        for _, size in spans:
            rules.append(f"\\cmidrule(lr){{{start}-{start + size - 1}}}")
            start += size
        top = [f"    & {' & '.join(heads)} \\\\", f"    {' '.join(rules)}"]
        top.append(f"    Method & {' & '.join(column_head(table.columns[index]) for index in indices)} \\\\")
        yield _tabular(len(indices), top, _lines(table, block, indices))


def _tabular(width: int, top: Sequence[str], blocks: Iterable[str]) -> str:
    lines = [f"  \\begin{{tabular}}{{l{'r' * width}}}", r"    \toprule", *top, r"    \midrule"]
    return "\n".join([*lines, "\n    \\midrule\n".join(blocks), r"    \bottomrule", r"  \end{tabular}"])


def _lines(table: Table, block: _Block, indices: Sequence[int]) -> Iterator[str]:
    """The rows of each kind."""
    for kind in ("method", "calibration", "published"):
        lines = []
        for row in (row for row in block.rows if row.kind == kind):
            if kind == "published" and all(row.cells[i].value is None for i in indices):
                continue
            lines.append(_line(row_name(row), [block.text(row.cells[i], table.columns[i]) for i in indices]))
            small = [block.below(row.cells[i], table.columns[i]) for i in indices] if block.below else []
            if any(small):
                lines += [
                    _line("", [f"{{\\tiny {text}}}" if text else "" for text in small]),
                    r"    \addlinespace[1pt]",
                ]
        if lines:
            yield "\n".join(lines)


def _line(name: str, cells: Sequence[str]) -> str:
    return f"    {' & '.join([name, *cells])} \\\\"


def _costs(table: Table, style: Style) -> Iterator[str]:
    """What methods cost, in one tabular or several that fit the width."""
    texts = [list(map(latex, cost_texts(row, table.timed_kind))) for row in table.computed]
    name = max((text_width(row_name(row)) for row in table.computed), default=0.0) + _GAP
    heads = [_stacked(title) for title in COST_TITLES]
    widths = [
        max(map(text_width, (*title.split(), *(row[i] for row in texts)))) + _GAP for i, title in enumerate(COST_TITLES)
    ]
    start = 0
    while start < len(heads):
        stop = start + 1
        while stop < len(heads) and name + sum(widths[start : stop + 1]) <= style.inches * _POINT:
            stop += 1
        top = [
            f"    & \\multicolumn{{{stop - start}}}{{c}}{{{latex(costs_title(table))}}} \\\\",
            f"    \\cmidrule(lr){{2-{stop - start + 1}}}",
            _line("Method", heads[start:stop]),
        ]
        rows = [_line(row_name(row), each[start:stop]) for row, each in zip(table.computed, texts, strict=True)]
        yield _tabular(stop - start, top, ["\n".join(rows)])
        start = stop


def _stacked(title: str) -> str:
    """A head of several short lines."""
    lines = r"\\".join(map(latex, title.split()))
    return f"\\shortstack[r]{{{lines}}}"


def _folded(table: Table, block: _Block, points: float) -> Iterator[list[int]]:
    """Consecutive columns that fit the width together; a group is cut only if it alone is wider."""
    name = max((text_width(row_name(row)) for row in block.rows), default=0.0) + _GAP
    widths = [_column_points(block, index, column) for index, column in enumerate(table.columns)]

    def fits(indices: Sequence[int]) -> bool:
        groups = dict.fromkeys(table.columns[index].group for index in indices)
        members = {group: [widths[i] for i in indices if table.columns[i].group == group] for group in groups}
        needed = (max(text_width(latex(group.title)) + _GAP, sum(each)) for group, each in members.items())
        return name + sum(needed) <= points

    batch: list[int] = []
    for group in table.groups:
        members = list(table.of_group(group))
        if batch and not fits([*batch, *members]):
            yield batch
            batch = []
        for index in members:
            if batch and not fits([*batch, index]):
                yield batch
                batch = []
            batch.append(index)
    if batch:
        yield batch


def _column_points(block: _Block, index: int, column: MetricColumn) -> float:
    head = max(map(text_width, latex(f"{column.metric.title} {column.metric.arrow}").split(" (")))
    cells = [text_width(block.text(row.cells[index], column)) for row in block.rows]
    small = [TINY * text_width(block.below(row.cells[index], column)) for row in block.rows] if block.below else []
    return max([head, *cells, *small]) + _GAP


def _named(table: Table) -> Table:
    """The table whose rows tell enrolment only where it differs; else a note tells it once."""
    if len(_enrolments(table)) > 1:
        return table
    return replace(table, rows=tuple(replace(row, enrolment="") for row in table.rows))


def _enrolments(table: Table) -> list[str]:
    return list(dict.fromkeys(row.enrolment for row in table.rows if row.kind == "method"))
