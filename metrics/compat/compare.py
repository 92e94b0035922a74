"""One prediction, or a folder of them, under many metrics side by side: a table for a terminal, Markdown or CSV.

Values of one quantity stand together, our own first: what a reader wants to see is how far apart they are.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from ..base import Metric, Score
from ..pair import Pair
from ..view import Looks

CSV_COLUMNS = ("file", "metric", "value", "unit", "better", "scored", "reason", "signature")


class Measure(Protocol):
    """What a table must know of a metric, of pairs or of a sequence."""

    @property
    def name(self) -> str: ...
    @property
    def title(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def decimals(self) -> int: ...
    @property
    def higher_is_better(self) -> bool: ...
    @property
    def signature(self) -> str: ...


@dataclass(frozen=True)
class MetricScores:
    """A metric and its scores by file; a metric of a sequence has one score, of all files."""

    metric: Measure
    scores: Mapping[str, Score]

    @cached_property
    def values(self) -> list[float]:
        return [score.value for score in self.scores.values() if score.value is not None]

    @property
    def mean(self) -> float | None:
        """Mean of the files that have a score."""
        return sum(self.values) / len(self.values) if self.values else None

    @property
    def covered(self) -> str:
        """Empty if every file has a score, else "3/4"."""
        return "" if len(self.values) == len(self.scores) else f"{len(self.values)}/{len(self.scores)}"

    @property
    def reason(self) -> str:
        """Why the first file without a score has none."""
        return next((score.reason for score in self.scores.values() if score.reason is not None), "")

    @property
    def quantity(self) -> str:
        """The title without what follows in brackets: PSNR (goliath) is PSNR, PSNR-H (stanford-orb) is PSNR too."""
        return self.metric.title.partition(" (")[0].removesuffix("-H").removesuffix("-L")

    @property
    def arrow(self) -> str:
        return "↑" if self.metric.higher_is_better else "↓"

    @property
    def shown(self) -> str:
        return "" if self.mean is None else f"{self.mean:.{self.metric.decimals}f}"


def lines(metrics: Sequence[Metric], pairs: Iterable[tuple[str, Pair | str]]) -> list[MetricScores]:
    """All metrics of all pairs, which are named by their files; pairs are taken one by one.

    Instead of a pair may stand the reason why there is none; then its scores have that reason.
    """
    found: list[dict[str, Score]] = [{} for _ in metrics]
    for name, pair in pairs:
        looks = None if isinstance(pair, str) else Looks(pair)
        row = [Score(None, str(pair)) if looks is None else _score(metric, looks) for metric in metrics]
        for of_metric, score in zip(found, row, strict=True):
            of_metric[name] = score
    return [MetricScores(metric, of_metric) for metric, of_metric in zip(metrics, found, strict=True)]


def _score(metric: Metric, looks: Looks) -> Score:
    """The score, or for a picture that is too large for the machine, that as the reason."""
    try:
        return metric.score(looks)
    except (MemoryError, RuntimeError) as error:  # torch has no type of its own for memory of a CPU
        if not isinstance(error, MemoryError) and "memory" not in str(error):
            raise
        height, width = looks.mask.shape
        return Score(None, f"not enough memory for {width}x{height} pixels; ask for fewer metrics with --only")


def render_terminal(found: Sequence[MetricScores]) -> RenderableType:
    """The values by quantity, as a rich renderable; `notes` says the rest."""
    values = Table(box=None, padding=(0, 2, 0, 0), show_header=False)
    values.add_column(no_wrap=True)
    values.add_column(no_wrap=True, justify="right")
    values.add_column(no_wrap=True)
    for quantity, of_quantity in _by_quantity(found):
        values.add_row(Text(f"{quantity} {of_quantity[0].arrow}", style="bold"))
        for line in of_quantity:
            unit = Text(line.metric.unit).append(f" {line.covered}" if line.covered else "", style="yellow")
            values.add_row(Text(f"  {line.metric.name}"), Text(line.shown), unit)
    return values


def notes(found: Sequence[MetricScores], remarks: Iterable[str] = ()) -> list[str]:
    """What the terminal says below the values: all signatures, and what has no value and why.

    Lines are as long as they are: a signature that was broken could not be searched for or copied.
    """
    return ["", "Signatures", *(line.metric.signature for line in found if line.values), *_missing(found), *remarks]


def render_markdown(found: Sequence[MetricScores], remarks: Iterable[str] = ()) -> str:
    """The values as one table, in the terminal's order, then a list of what has no value and why."""
    text = ["| metric | | value | | signature |", "| :-- | :-: | --: | :-- | :-- |"]
    for _, of_quantity in _by_quantity(found):
        for line in of_quantity:
            unit = " ".join(part for part in (line.metric.unit, line.covered) if part)
            signature = line.metric.signature.replace("|", r"\|")
            text.append(f"| {line.metric.name} | {line.arrow} | {line.shown} | {unit} | `{signature}` |")
    below = [f"- {note}" for note in (*_missing(found), *remarks)]
    return "\n".join([*text, *([""] if below else []), *below, ""])


def render_csv(found: Sequence[MetricScores]) -> str:
    """One line a file and metric, then, of several files, one of their mean with an empty file; full precision."""
    out = io.StringIO()
    writer = csv.DictWriter(out, CSV_COLUMNS, lineterminator="\n")
    writer.writeheader()
    for line in found:
        about = {
            "metric": line.metric.name,
            "unit": line.metric.unit,
            "better": "higher" if line.metric.higher_is_better else "lower",
            "signature": line.metric.signature,
        }
        for file, score in line.scores.items():
            scored = f"{int(score.value is not None)}/1"
            writer.writerow({"file": file, **about, "value": score.value, "scored": scored, "reason": score.reason})
        if len(line.scores) > 1:
            scored = f"{len(line.values)}/{len(line.scores)}"
            writer.writerow({"file": "", **about, "value": line.mean, "scored": scored, "reason": line.reason})
    return out.getvalue()


def _by_quantity(found: Iterable[MetricScores]) -> Iterator[tuple[str, list[MetricScores]]]:
    """Lines with a value, those of one quantity and direction together, in the order in which quantities first come."""
    groups: dict[tuple[str, str], list[MetricScores]] = {}
    for line in found:
        if line.values:
            groups.setdefault((line.quantity, line.arrow), []).append(line)
    for (quantity, _), of_quantity in groups.items():
        yield quantity, of_quantity


def _missing(found: Iterable[MetricScores]) -> Iterator[str]:
    """One sentence for each reason why metrics have no value for some or all files."""
    reasons: dict[str, list[str]] = {}
    for line in found:
        if line.reason:
            reasons.setdefault(line.reason, []).append(line.metric.name)
    for reason, names in reasons.items():
        yield f"no value ({reason}): {', '.join(names)}"
