"""What an audit looks at: a run folder, and the protocol, capture, methods and metrics that it names."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias

from ...data.capture import Capture, open_capture
from ...data.exr import read_exr, stack
from ...errors import InputError
from ...registry import METHODS, METRICS
from ...scene import Frame, Prediction
from ..cell import Bench, CaptureReader
from ..plan import Plan, make_plan
from ..priors import Priors
from ..progress import steps
from ..protocol import Protocol, Selected, resolve
from ..run import find_protocol
from ..store import Store

Tables: TypeAlias = Callable[[Path], Any]


@dataclass(frozen=True)
class Evidence:
    """A run as it lies on disk (`plan` is run.json, `cells` those of the plan that are there), and what it names."""

    store: Store
    plan: dict[str, Any]
    cells: tuple[dict[str, Any], ...]
    protocol: Protocol
    capture: Capture
    tables: Tables

    @cached_property
    def frames(self) -> dict[str, Frame]:
        """Every frame of the capture by its key."""
        return {frame.key: frame for frame in self.capture.frames()}

    @cached_property
    def selected(self) -> Selected:
        """The protocol applied to the capture. Raises `InputError` as `resolve` does."""
        return resolve(self.protocol, self.capture.frames())

    @cached_property
    def foreign(self) -> set[str]:
        """Methods that are not registered here: prediction folders, and plug-ins that are not installed."""
        return {info["name"] for info in self.plan["methods"]} - set(METHODS.entries())

    @cached_property
    def planned(self) -> dict[str, Plan]:
        """What this version of handbench would plan, by method: the same protocol, capture, preset and seeds."""
        return {
            info["name"]: make_plan(
                self.protocol, self.capture.digest, [info["name"]], self.plan["seeds"], info["preset"]
            )
            for info in self.plan["methods"]
            if info["name"] not in self.foreign
        }

    @cached_property
    def metrics_module(self) -> ModuleType:
        return importlib.import_module(METRICS.package)

    @cached_property
    def metrics(self) -> dict[str, Any]:
        """The run's metrics by signature, made from the signature alone. Raises `InputError` for an unknown one."""
        named = [metric["signature"] for metric in self.plan["protocol"]["metrics"]]
        return {signature: self.metrics_module.from_signature(signature) for signature in named}

    @cached_property
    def bench(self) -> Bench:
        """What the run's cells were computed with; its reader and its trainings are the audit's own."""
        reader = CaptureReader(self.capture)
        shared = (self.store, Priors(self.store), self.metrics, self.metrics_module)
        return Bench(self.protocol, self.selected, reader, *shared)

    @cached_property
    def table(self) -> Any:
        return self.tables(self.store.folder)

    def info(self, method: str) -> dict[str, Any]:
        return next(info for info in self.plan["methods"] if info["name"] == method)

    def kept(self, cell: dict[str, Any], query: str) -> Prediction:
        """The picture that a cell kept of a query, in half floats. Raises `InputError` if it is missing or damaged."""
        path = self.store.folder / cell["predictions"] / f"{query.replace('/', '__')}.exr"
        channels = read_exr(path)
        return Prediction(stack(channels, ("R", "G", "B"), path), stack(channels, ("A",), path)[..., 0])

    def pair(self, frame: Frame, picture: Prediction) -> Any:
        """A picture and the truth of its frame, for metrics."""
        return self.metrics_module.Pair.of(picture, self.bench.reader(frame), frame.mesh)


Check: TypeAlias = Callable[[Evidence], tuple[bool | None, str]]
"""Whether what is claimed holds (None: it cannot be told here), and what was found."""


def scored_queries(cell: dict[str, Any]) -> list[str]:
    """The queries of a cell that have a value, so a kept picture, in the order of their keys."""
    return sorted({score["query"] for score in cell["scores"] if score["value"] is not None})


def gather(folder: Path, tables: Tables, protocol: str | None, data: Path | None) -> Evidence:
    """The evidence of a run; see `audit` for what is raised."""
    store = Store(folder)
    plan = store.run()
    if plan is None:
        raise InputError(f"{folder} holds no readable run.json; give the folder that 'handbench run' printed")
    told = plan["protocol"]
    try:
        found = find_protocol(protocol or told["name"])
    except InputError as error:
        raise InputError(
            f"{error}; the run is of {told['name']}@{told['version']}, give its file with --protocol"
        ) from error
    if found.digest != told["digest"]:
        raise InputError(
            f"protocol {found.label} is not the one that {folder} was run with ({told['name']}@{told['version']}); "
            "give the run's own file with --protocol"
        )
    with steps() as progress:
        capture = open_capture(found.capture, found.size, data, progress)
    if capture.digest != plan["capture"]["digest"]:
        raise InputError(
            f"capture {capture.name} has digest {capture.digest}, {folder} was run on {plan['capture']['digest']}; "
            "name the folder of the run's own capture with --data"
        )
    cells = (store.cell(key) for key in plan["cells"])
    return Evidence(store, plan, tuple(cell for cell in cells if cell is not None), found, capture, tables)
