"""NaN put in at every stage of a run must show in its table: fewer values than queries, a reason, and no rank.

A grey picture is the method: one that is sound, and one with a fault at a stage. Both go through the bench as any
method does, on a few queries of the run's own protocol and capture, into a folder that is thrown away.
"""

from __future__ import annotations

import json
import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...bench import given
from ...bench.cell import Bench, compute
from ...bench.describe import method_record
from ...bench.plan import Cell
from ...bench.priors import Priors
from ...bench.store import Store
from ...errors import Damaged
from ...method import Avatar, Method, MethodInfo, Prior, Progress, RecordedAvatar, Recording, silent
from ...results.record import CellRecord
from ...results.recordfile import sealed
from ...scene import LIGHT_KINDS, Frame, Prediction, Query
from .evidence import Evidence

_QUERIES = 3
_GREY = 0.2
_SOUND = "audit-sound"


@dataclass(frozen=True)
class Injection:
    """Where NaN is put in, and how many of the queries' values it spoils (None: all; 0: the file is refused)."""

    name: str
    spoils: int | None

    def check(self, evidence: Evidence) -> tuple[bool | None, str]:
        """The fault shows, and the sound method's values do not suffer."""
        with tempfile.TemporaryDirectory() as place:
            try:
                table = _run(evidence, self, Path(place))
            except Damaged as error:
                return self.spoils == 0, f"refused: {str(error).replace(place, '')}"
        if self.spoils == 0:
            return False, "a cell that holds NaN is read"
        sound, faulty = (next(row for row in table.rows if row.name == name) for name in (_SOUND, _named(self)))
        if self.name in _ONE_METRIC and not sound.cells[0].covered:
            return None, f"{table.columns[0].metric.title} needs more than a grey picture"
        for index, column in enumerate(table.columns):
            clean, spoiled = sound.cells[index], faulty.cells[index]
            if not clean.covered:
                continue  # a grey picture has no geometry to score
            title = column.metric.title
            lost = clean.covered if self.spoils is None else self.spoils
            if index and self.name in _ONE_METRIC:
                lost = 0
            if spoiled.covered != clean.covered - lost:
                return False, f"{title} counts {spoiled.covered} values of {clean.covered}, {lost} of them NaN"
            if spoiled.value is not None and not math.isfinite(spoiled.value):
                return False, f"{title} of the table is {spoiled.value}"
            if (spoiled.value is None) != (spoiled.covered == 0):
                return False, f"{title} is {spoiled.value} although {spoiled.covered} values are there"
            if lost and not spoiled.notes:
                return False, f"{title} misses {lost} values without a word"
            if lost and (spoiled.rank or clean.rank != 1):
                return False, f"{title} ranks the spoiled row {spoiled.rank} and the sound one {clean.rank}"
        first = next(i for i, cell in enumerate(sound.cells) if cell.covered)
        cell = faulty.cells[first]
        return True, f"{cell.covered}/{cell.expected} values, “{table.footnotes[cell.notes[0] - 1]}”, never ranked"


STAGES = (
    Injection("training", None),
    Injection("personalising", None),
    Injection("a prediction", 1),
    Injection("a metric", None),
    Injection("a stored value", 0),
)
_ONE_METRIC = ("a metric",)


def _named(stage: Injection) -> str:
    return f"audit-{stage.name}"


def _run(evidence: Evidence, stage: Injection, folder: Path) -> Any:
    """The table of a run of the sound and the faulty method."""
    store, frames, column = Store(folder), *_few(evidence)
    store.prepare()
    selected = replace(evidence.selected, scored={column: tuple(frames)})
    bench = replace(evidence.bench, selected=selected, store=store, priors=Priors(store))
    template = _template(evidence, frames[0].subject)
    sound = _Grey(_SOUND, "", "")
    spoiled = given.asked(selected, sound.info, frames[0]).key
    methods = {_SOUND: sound, _named(stage): _Grey(_named(stage), stage.name, spoiled)}
    cells: list[Cell] = []
    for name, method in methods.items():
        key = name.replace(" ", "-")
        planned = Cell(key, key, name, "quick", frames[0].subject, 0)
        faulty = stage.name == "a metric" and name != _SOUND
        found = compute(replace(bench, metrics=_broken(bench)) if faulty else bench, planned, method, lambda _: silent)
        about: dict[str, Any] = {"key": key, "prior": key, "seed": 0, "method": method_record(planned, method)}
        store.write_cell(replace(template, metrics=tuple(bench.metrics), **about, **vars(found)))
        cells.append(planned)
    if stage.spoils == 0:
        _spoil(folder / "cells" / f"{cells[1].key}.json")
    protocol = evidence.plan.protocol
    kept = next(each for each in protocol.columns if each.name == column)
    kept = replace(kept, queries=tuple(frame.key for frame in frames))
    plan = replace(
        evidence.plan,
        protocol=replace(protocol, published=(), columns=(kept,)),
        methods=tuple(method_record(cell, methods[cell.method]) for cell in cells),
        seeds=(0,),
        subjects=(frames[0].subject,),
        cells=tuple(cell.key for cell in cells),
    )
    store.write_run(plan)
    return evidence.tables(folder)


def _few(evidence: Evidence) -> tuple[list[Frame], str]:
    """A few scored frames of one subject, and their column."""
    best: tuple[list[Frame], str] = ([], "")
    for column, scored in evidence.selected.scored.items():
        for subject in evidence.protocol.subjects:
            frames = [frame for frame in scored if frame.subject == subject][:_QUERIES]
            best = max(best, (frames, column), key=lambda found: len(found[0]))
    return best


def _template(evidence: Evidence, subject: str) -> CellRecord:
    """A cell of the run, whose records the audit's own cells take over."""
    cell = next((cell for cell in evidence.cells if cell.subject == subject), evidence.cells[0])
    return replace(cell, subject=subject)


def _broken(bench: Bench) -> dict[str, Any]:
    """The metrics, the first of which always measures NaN."""
    first, *others = bench.metrics.items()
    signature, metric = first
    spoiled = replace(metric, family=replace(metric.family, measure=lambda *_: math.nan))
    return {signature: spoiled, **dict(others)}


def _spoil(path: Path) -> None:
    """Write NaN in the place of the first value of a stored cell, as a careless writer would."""
    cell = json.loads(path.read_text(encoding="utf-8"))
    cell["scores"][0]["values"][0] = math.nan
    path.write_text(json.dumps(sealed(cell)), encoding="utf-8")


class _Avatar(RecordedAvatar):
    def __init__(self, grey: float, spoiled: str) -> None:
        self._grey, self._spoiled = grey, spoiled

    def relight(self, query: Query) -> Prediction:
        image = np.full((query.camera.height, query.camera.width, 3), self._grey, np.float32)
        if query.key == self._spoiled:
            image[::7, ::5] = np.nan
        return Prediction(image, np.ones(image.shape[:2]))


class _Trained(Prior):
    def __init__(self, grey: float, fault: str, spoiled: str) -> None:
        self._grey, self._fault, self._spoiled = grey, fault, spoiled

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        grey = math.nan if self._fault == "personalising" else self._grey
        return _Avatar(grey, self._spoiled if self._fault == "a prediction" else "")

    def save(self, folder: Path) -> None:
        (folder / "grey.json").write_text(json.dumps(self._grey))


class _Grey(Method):
    """Draws grey, unless its fault is at work: a training whose loss is NaN, and so what it learns, and so on."""

    def __init__(self, name: str, fault: str, spoiled: str) -> None:
        self.info = MethodInfo(name, name, "a grey picture", universal=True, lights=LIGHT_KINDS)
        self._fault, self._spoiled = fault, spoiled

    @property
    def config(self) -> dict[str, Any]:
        return {"fault": self._fault}

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        loss = math.nan if self._fault == "training" else 0.0
        progress(1, 1, loss=loss)
        return _Trained(_GREY + loss, self._fault, self._spoiled)

    def load(self, folder: Path) -> Prior:
        return _Trained(json.loads((folder / "grey.json").read_text()), self._fault, self._spoiled)
