"""Where cells are computed: a job as light values that can be sent anywhere, and the loop over its cells.

Every process that works for a run folder goes through `work`: the local run, each shard, each worker of a cluster.
Claims keep them from doing the same twice, and a cell's key is its file's name, so none is counted twice.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from ..data.capture import Capture
from ..errors import InputError
from ..method import Method, Progress
from ..metricspec import MetricSpec
from ..registry import CAPTURES, METRICS, Entry
from ..results.origin import Provenance
from ..results.record import CellRecord
from ..tuning import tune
from .opening import open_data, select
from .plan import Cell, ChangesOf, Plan, make_method, make_plan, method_entries, refusals, with_changes
from .progress import Steps
from .protocol import Protocol
from .store import Store

if TYPE_CHECKING:
    from ..metrics import Metric
    from .cell import Bench

_LONGEST_PAUSE = 5.0  # seconds between looks at what other processes have done


@dataclass(frozen=True)
class Job:
    """What a run is asked to do; `extra` are methods that are not registered, `changes` the settings that are changed,
    `data` is where captures are kept."""

    protocol: Protocol
    methods: tuple[str, ...]
    seeds: tuple[int, ...] | None
    preset: str | None
    folder: Path
    data: Path | None
    command: tuple[str, ...]
    extra: tuple[Entry, ...] = ()
    changes: ChangesOf = ()

    @property
    def store(self) -> Store:
        return Store(self.folder)

    @property
    def entries(self) -> dict[str, Entry]:
        """The plug-ins of the methods. Raises `InputError` for an unknown one."""
        return with_changes(method_entries(self.methods, self.extra), self.changes)

    @property
    def presets(self) -> dict[str, str]:
        return {name: self.preset or self.protocol.preset_of(name) for name in self.methods}

    def open_capture(self, told: Steps) -> Capture:
        return open_data(self.protocol, self.data, told)

    def plan(self, capture: Capture) -> Plan:
        return make_plan(self.protocol, capture.digest, self.methods, self.seeds, self.preset, self.extra, self.changes)

    def make_tools(self) -> Tools:
        """Raises `InputError` for an unknown preset, a broken plug-in and metrics of one signature."""
        from ..metrics import metric

        metrics = {made.signature: made for made in map(metric, self.protocol.metrics)}
        if len(metrics) < len(self.protocol.metrics):
            raise InputError(f"protocol {self.protocol.label}: two metrics have one signature; keep one of them")
        methods = {name: make_method(entry, self.presets[name]) for name, entry in self.entries.items()}
        return Tools(methods, metrics)


@dataclass(frozen=True)
class Tools:
    """Methods by name and metrics by signature, made."""

    methods: dict[str, Method]
    metrics: dict[str, Metric]


@dataclass(frozen=True)
class Site:
    """A job opened in this process."""

    job: Job
    plan: Plan
    tools: Tools
    capture: Capture

    @cached_property
    def bench(self) -> Bench:
        from .cell import Bench
        from .priors import Priors
        from .reader import CaptureReader

        store, tools = self.job.store, self.tools
        selected = select(self.plan.protocol, self.capture)
        reader, priors = CaptureReader(self.capture), Priors(store)
        return Bench(self.plan.protocol, selected, reader, store, priors, tools.metrics)

    @cached_property
    def refused(self) -> dict[str, str]:
        """Why cells are refused before anything trains, by their keys."""
        return refusals(self.plan, self.bench.selected, self.tools.methods)

    @cached_property
    def drawings(self) -> dict[str, str]:
        """The cells that the folder holds by the key of their pictures."""
        return self.bench.store.drawings()

    @cached_property
    def origin(self) -> Provenance:
        """The provenance of what is computed here."""
        from .provenance import provenance

        metrics = (METRICS.entry(MetricSpec.parse(spec).name) for spec in self.plan.protocol.metrics)
        protocol = self.plan.protocol
        captures = {protocol.capture, *(protocol.trains_on or ())[:1]}
        plugins = (*self.job.entries.values(), *metrics, *map(CAPTURES.entry, sorted(captures)))
        return provenance(list(self.job.command) or sys.argv, [entry.target for entry in plugins])


@dataclass(frozen=True)
class Done:
    """How many cells were computed, and why those that are lost are not there, by their keys."""

    computed: int = 0
    lost: Mapping[str, str] = field(default_factory=dict)


def finished(cell: CellRecord | None) -> bool:
    """Whether a cell's file is there and needs no other try: its method did not crash."""
    return cell is not None and cell.error is None


def work(site: Site, cells: Sequence[Cell], told: Steps, overall: Progress) -> Done:
    """Compute cells, each in one process only, and wait for those that other processes are at.

    A cell that crashed before is tried again, once.
    """
    tune()
    store = site.bench.store
    before = {cell.key: store.cell(cell.key) for cell in cells}
    left, done, computed, pause = list(cells), 0, 0, 0.1
    while left:
        later = []
        for cell in left:
            with ExitStack() as claims:
                if not _claim(store, cell, claims):
                    later.append(cell)
                    continue
                now = store.cell(cell.key)
                if not finished(now) and now == before[cell.key]:  # nobody else has been here
                    _compute(site, cell, told)
                    computed += 1
            done += 1
            overall(done, len(cells))
        if len(later) < len(left):
            pause = 0.1
        else:
            told(f"wait for {store.holder(later[0].key, later[0].prior)}")(done, len(cells))
            time.sleep(pause)
            pause = min(2 * pause, _LONGEST_PAUSE)
        left = later
    return Done(computed)


def _claim(store: Store, cell: Cell, claims: ExitStack) -> bool:
    """Take a cell, and the training it needs if that is still to be done; False if another process has either."""
    if not claims.enter_context(store.claim(cell.key)):
        return False
    return store.prior(cell.prior) is not None or claims.enter_context(store.claim(cell.prior))


def _compute(site: Site, cell: Cell, told: Steps) -> None:
    from .cell import compute
    from .describe import cell_record
    from .rescoring import rescored

    store, method = site.bench.store, site.tools.methods[cell.method]
    found, kept = None, None if method.info.truth else store.drawn(site.drawings.get(cell.drawing))
    if kept is not None:
        told(f"{cell.label}: score kept pictures")(0, 1)
        found = rescored(site.bench, cell, kept)
    found = found or compute(site.bench, cell, method, told)
    about = (site.plan, cell, method, site.bench.selected, site.tools.metrics, site.origin)
    store.write_cell(cell_record(*about, found))
    store.remove_checkpoints(cell.key)
