"""Run folders as they are read: the plan of the last run, its finished cells, and whether runs can be compared."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from ..bench.store import Store
from ..errors import InputError
from ..scene import Prediction
from .record import CellRecord, MethodRecord, PriorRecord, RunRecord


@dataclass(frozen=True)
class Run:
    """A run as it lies on disk, or several as one (see `merged`).

    plan      run.json
    others    folders that may hold cells which this one lacks
    parts     the runs that it was merged from
    given     its finished cells, where they need not be read by the plan's keys
    """

    folder: Path
    plan: RunRecord
    others: tuple[Path, ...] = ()
    parts: tuple[Run, ...] = ()
    given: tuple[CellRecord, ...] | None = None

    @property
    def store(self) -> Store:
        return Store(self.folder)

    @cached_property
    def cells(self) -> tuple[CellRecord, ...]:
        """The finished cells in the order of the plan, read when first asked for; one that is absent is left out.

        Raises `Damaged` for a cell that is not what was written, and `InputError` for one that a newer version wrote.
        """
        if self.given is not None:
            return self.given
        found = (next(filter(None, (store.read_cell(key) for store in self._stores)), None) for key in self.plan.cells)
        return tuple(filter(None, found))

    @property
    def _stores(self) -> list[Store]:
        return [Store(folder) for folder in (self.folder, *self.others)]

    def read_prediction(self, cell: CellRecord, query: str) -> Prediction:
        """The picture that a cell kept of a query, from the folder that has it. Raises as `Store.read_prediction`."""
        there = (store for store in self._stores if store.picture(cell.key, query).exists())
        return next(there, self.store).read_prediction(cell, query)

    def read_prior(self, key: str) -> PriorRecord | None:
        """What is known of a kept training, from the folder that has it. Raises as `Store.read_prior`."""
        return next(filter(None, (store.read_prior(key) for store in self._stores)), None)

    @property
    def in_order(self) -> list[CellRecord]:
        """The finished cells by seed and subject, whatever the order of the plan."""
        return sorted(self.cells, key=lambda cell: (cell.seed, cell.subject))

    def of_method(self, name: str) -> tuple[CellRecord, ...]:
        return tuple(cell for cell in self.cells if cell.method.name == name)

    @property
    def protocol(self) -> str:
        """ "quick@1"."""
        return self.plan.protocol.label


def read_run(folder: Path) -> Run:
    """The run of a folder, each method under a title of its own.

    Raises `InputError` for a folder without a run or with a newer version's, `Damaged` for a damaged run.json.
    """
    plan = read_plan(folder)
    return Run(folder, replace(plan, methods=titled_apart(plan.methods)))


def titled_apart(methods: Sequence[MethodRecord]) -> tuple[MethodRecord, ...]:
    """The methods, with the name after each title that several have: "Phong (urhand-phong)"."""
    count = Counter(method.title for method in methods)
    apart = (replace(m, title=f"{m.title} ({m.name})") if count[m.title] > 1 else m for m in methods)
    return tuple(apart)


def read_plan(folder: Path) -> RunRecord:
    plan = Store(folder).read_run()
    if plan is None:
        raise InputError(f"{folder} holds no readable run.json; give the folder that 'handbench run' printed")
    return plan


def merged(runs: Sequence[Run]) -> Run:
    """Several runs of one protocol version and capture as one, with the folder of the first.

    A method that several hold with the same cells (the same keys, so the same source, preset, data and seeds) is there
    once; one that differs is there again, its name and title marked with the folder of the later run. Raises
    `InputError` for runs that cannot be one.
    """
    for other in runs[1:]:
        if why := mismatch(runs[0], other):
            raise InputError(f"these runs cannot share a table: {why}")
    if len(runs) == 1:
        return runs[0]
    parts = completed(runs)
    seen: dict[str, list[set[str]]] = {}
    methods: list[MethodRecord] = []
    cells: list[CellRecord] = []
    seeds: dict[str, tuple[int, ...]] = {}
    for run, label in zip(parts, _labels(parts), strict=True):
        for method in run.plan.methods:
            own = run.of_method(method.name)
            keys, before = {cell.key for cell in own}, seen.setdefault(method.name, [])
            if keys not in before:
                mark = f" ({label})" if before else ""
                name, title = f"{method.name}{mark}", f"{method.title}{mark}"
                methods.append(replace(method, name=name, title=title))
                cells += [replace(cell, method=replace(cell.method, name=name, title=title)) for cell in own]
                seeds[name] = run.plan.seeds_for(method.name)
                before.append(keys)
    every = tuple(dict.fromkeys(key for run in parts for key in run.plan.cells))
    plan = replace(runs[0].plan, methods=titled_apart(methods), cells=every, seeds_of=seeds)
    folders = tuple(run.folder for run in runs[1:])
    return Run(runs[0].folder, plan, folders, parts, tuple(cells))


def _labels(runs: Sequence[Run]) -> list[str]:
    """The names of the folders, or their paths where names are alike."""
    names = [run.folder.resolve().name for run in runs]
    return names if len(set(names)) == len(names) else [str(run.folder) for run in runs]


def completed(runs: Sequence[Run]) -> tuple[Run, ...]:
    """The runs, each with the finished cells of the others: the parts of a sharded run complete each other."""
    folders = [run.folder for run in runs]
    return tuple(Run(run.folder, run.plan, tuple(each for each in folders if each != run.folder)) for run in runs)


def mismatch(first: Run, other: Run) -> str | None:
    """Why values of two runs cannot stand in one table, in one clause that names both; None if they can."""
    one, two = first.plan.protocol, other.plan.protocol
    if (one.label, one.digest) != (two.label, two.digest):
        told = [f"{run.folder} ran {run.protocol} ({run.plan.protocol.digest[:8]})" for run in (first, other)]
        return f"the protocols differ: {', '.join(told)}"
    signatures = [{metric.signature for metric in protocol.metrics} for protocol in (one, two)]
    if signatures[0] != signatures[1]:
        return f"the metrics differ: {', '.join(sorted(signatures[0] ^ signatures[1]))} is in one run only"
    if first.plan.capture.digest != other.plan.capture.digest:
        told = [f"{run.folder} used {_capture(run)}" for run in (first, other)]
        return f"the data differ: {', '.join(told)}"
    columns = [{column.name: column.queries for column in protocol.columns} for protocol in (one, two)]
    for name in {**columns[0], **columns[1]}:
        if columns[0].get(name) != columns[1].get(name):
            return f"the scored frames of column {name!r} differ between {first.folder} and {other.folder}"
    return None


def _capture(run: Run) -> str:
    capture = run.plan.capture
    return f"{' '.join(filter(None, (capture.name, capture.size)))} ({capture.digest[:8]})"
