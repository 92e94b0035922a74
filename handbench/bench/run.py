"""Run a protocol: every cell that is not in the run folder yet."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import InputError, unknown_name
from ..registry import PROTOCOLS, Entry
from ..settings import Setting
from ..shards import Shard
from .changes import assigned
from .describe import protocol_record, run_record
from .executor import Done, Job, Site, finished, work
from .joining import joined, kept
from .naming import run_folder
from .plan import Cell, Plan, by_prior, check_preset, default_methods
from .progress import Steps, steps
from .protocol import Protocol
from .reuse import take
from .store import Store

EXECUTORS = ("local", "ray")


@dataclass(frozen=True)
class RunSummary:
    """What a run did.

    `computed` and `reused` count cells, of the shard if it was one, and `taken` those of the reused that came from
    other run folders; `crashed` names those whose method crashed, and why; `refused` names those computed now whose
    method needs what is not given, and why; `missing` names those of other shards that are not there yet: without any,
    a report is complete. `kept` names rows of earlier commands that the folder's tables still show, `gone` those that
    they no longer do, and why.
    """

    folder: Path
    computed: int
    reused: int
    crashed: tuple[str, ...]
    missing: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()
    taken: int = 0
    kept: tuple[str, ...] = ()
    gone: tuple[str, ...] = ()


def find_protocol(name: str) -> Protocol:
    """A registered protocol, or the one in a TOML file. Raises `InputError` for an unknown name or a bad file."""
    if name.endswith(".toml"):
        from ..protocols import load

        return load(Path(name))
    return PROTOCOLS.load(name)


def run(
    protocol: Protocol,
    methods: Iterable[str] | None = None,
    seeds: Iterable[int] | None = None,
    preset: str | None = None,
    out: Path | None = None,
    data: Path | None = None,
    command: Iterable[str] = (),
    *,
    extra: Sequence[Entry] = (),
    shard: Shard | None = None,
    executor: str = "local",
    cpus: int | None = None,
    settings: Sequence[Setting] = (),
    reuse: Sequence[Path] = (),
) -> RunSummary:
    """Compute the missing cells of a protocol into `out` (default: see `run_folder`) and say what was done.

    A finished cell is never computed again while nothing that decides it changed; a cell whose method crashed is
    tried again. A method's failure becomes the reason of its scores and stops no other cell. Any number of runs may
    share a folder, on machines that share a disk: what one is at work on, the others leave to it.

    methods     names; None: those of the protocol, then `extra`
    extra       methods that are not registered; their names and settings are part of a cell's key
    settings    of methods' configurations, changed; they are part of a cell's key and of a method's title
    reuse       run folders whose finished cells and trainings of the same keys are taken, instead of computed
    shard       compute only the cells of this part of the plan; run.json tells the whole plan
    executor    "local", or "ray": on the nodes of a Ray cluster, see `cluster.py`
    cpus        cores that "ray" gives a cell; None: as many as the smallest node has

    Raises `InputError` for what the user can mend and `StorageError` when the run folder cannot be written; finished
    cells stay.
    """
    names = tuple(dict.fromkeys(default_methods(protocol, extra) if methods is None else methods))
    folder, chosen = out or run_folder(protocol, settings), None if seeds is None else tuple(seeds)
    # Absolute: a method may change the working directory.
    places = folder.absolute(), data and data.absolute()
    job = Job(protocol, names, chosen, preset, *places, tuple(command), tuple(extra))
    _check_executor(executor, cpus)
    check_preset(tuple(job.entries.values()), preset)
    job = replace(job, changes=assigned(settings, job.entries, job.presets))
    # What is mistyped is told before a capture is generated; what this folder has run before is not loaded to know.
    known = not job.changes and _known(job.store, protocol, {name: job.presets[name] for name in job.entries})
    tools = None if known else job.make_tools()
    job.store.prepare()
    with steps() as told:
        capture = job.open_capture(told)
        plan = job.plan(capture)
        cells = plan.cells if shard is None else shard.of(by_prior(plan.cells))
        missing = [cell for cell in cells if not finished(job.store.cell(cell.key))]
        taken = take(job.store, missing, reuse)
        missing = [cell for cell in missing if not finished(job.store.cell(cell.key))] if taken else missing
        done = Done()
        refused: tuple[str, ...] = ()
        gone: tuple[str, ...] = ()
        if missing or not _refresh(job.store, plan):
            site = Site(job, plan, tools or job.make_tools(), capture)
            gone = _announce(site, shard)
            refused = tuple(f"{cell.label}: {site.refused[cell.key]}" for cell in missing if cell.key in site.refused)
            done = _execute(site, missing, told, executor, cpus)
            job.store.sweep()  # of those that were killed meanwhile
    record = job.store.run()
    rows = kept(record, names) if record else ()
    outcome = _outcome(folder, job.store, plan, cells, missing, done)
    return replace(outcome, refused=refused, taken=taken, kept=rows, gone=gone)


def _outcome(
    folder: Path, store: Store, plan: Plan, cells: Sequence[Cell], tried: Sequence[Cell], done: Done
) -> RunSummary:
    crashed = []
    for cell in tried:
        found = store.cell(cell.key)
        if not finished(found):
            reasons = [frame.reason for frame in found.scores if frame.reason] if found else []
            crashed.append(f"{cell.label}: {(reasons or [done.lost.get(cell.key, 'not computed')])[0]}")
    elsewhere = set(plan.cells) - set(cells)
    missing = [cell.label for cell in plan.cells if cell in elsewhere and store.cell(cell.key) is None]
    reused = len(cells) - done.computed - len(done.lost)
    return RunSummary(folder, done.computed, reused, tuple(crashed), tuple(missing))


def _check_executor(name: str, cpus: int | None) -> None:
    if name not in EXECUTORS:
        raise unknown_name("executor", name, EXECUTORS)
    if name == "ray":
        from .cluster import require_ray

        require_ray()
    elif cpus is not None:
        raise InputError(
            "cores are given to cells with --executor ray only; here OMP_NUM_THREADS says how many are used"
        )


def _execute(site: Site, cells: Sequence[Cell], told: Steps, executor: str, cpus: int | None) -> Done:
    if executor == "local" or not cells:
        return work(site, cells, told, told("all cells"))
    from .cluster import work_on_ray

    return work_on_ray(site, cells, told("all cells"), cpus)


def _announce(site: Site, shard: Shard | None) -> tuple[str, ...]:
    """Write run.json, with what earlier commands planned in the folder; what of that is gone.

    Shards write the same one: where it tells their plan already it stays, and it names no shard.
    """
    store = site.job.store
    if _refresh(store, site.plan) and shard is not None:
        return ()
    origin = replace(site.origin, command=shlex.join(_without_shard(site.job.command or sys.argv)))
    now = run_record(site.plan, site.tools.methods, site.tools.metrics, site.bench.selected, origin)
    before = store.run()
    seeds = tuple(dict.fromkeys((*now.seeds, *(before.seeds if before else ()))))
    again = site.plan if seeds == site.plan.seeds else replace(site.job, seeds=seeds).plan(site.capture)
    found = joined(now, before, store.cell, {cell.key for cell in again.cells})
    store.write_run(found.record)
    from .lightpictures import light_pictures

    scored = {frame.key: frame for frames in site.bench.selected.scored.values() for frame in frames}
    for name, content in light_pictures(scored.values()):
        store.write_light(name, content)
    return found.gone


def _without_shard(command: Sequence[str]) -> list[str]:
    kept, words = [], iter(command)
    for word in words:
        name, equals, _ = word.partition("=")
        if not (name.startswith("--sh") and "--shard".startswith(name)):
            kept.append(word)
        elif not equals:
            next(words, None)
    return kept


def _known(store: Store, protocol: Protocol, presets: dict[str, str]) -> bool:
    """Whether the folder's last run had the same metrics, methods and presets."""
    told = store.run()
    if told is None or told.protocol.digest != protocol.digest:
        return False
    return presets.items() <= {method.name: method.preset for method in told.methods}.items()


def _refresh(store: Store, plan: Plan) -> bool:
    """Whether run.json already tells this plan; a changed title is brought up to date without loading anything."""
    told = store.run()
    if told is None or told.protocol.digest != plan.protocol.digest:
        return False
    if not {cell.key for cell in plan.cells} <= set(told.cells):
        return False
    queries = {column.name: column.queries for column in told.protocol.columns}
    now = protocol_record(plan.protocol, told.protocol.metrics, queries)
    if now != told.protocol:
        store.write_run(replace(told, protocol=now))
    return True
