"""A generated capture made as runs are computed: here, in shards, or on the nodes of a Ray cluster."""

from __future__ import annotations

import os
import socket
from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from ..data.capture import open_capture
from ..data.openstage import PRESETS, capture_folder, generated, lacking, preset
from ..data.openstage.helpers import helped
from ..data.openstage.presets import CaptureName
from ..errors import InputError, unknown_name
from ..method import Progress, silent
from ..registry import CAPTURES
from ..shards import Shard
from .cluster import on_cluster, soon, task_failure
from .progress import Steps
from .run import EXECUTORS

_PARTS = 4  # tasks for each that can run at once, so that slow ones do not hold up the rest


def make_capture(
    name: str,
    size: str,
    folder: Path | None,
    steps: Steps,
    shard: Shard | None = None,
    executor: str = "local",
    cpus: int | None = None,
    processes: int = 1,
) -> tuple[str, ...]:
    """Generate what is missing of a capture; returns the keys of poses of other shards that are not there yet.

    shard       make only the poses of this part, in a folder that all parts share
    executor    "local", or "ray": on the nodes of a Ray cluster, which share the disk of the folder
    cpus        cores that "ray" gives a task; None: as many as the smallest node has
    processes   how many of this machine share the work, if neither shard nor executor says otherwise

    Raises `InputError` for an unknown capture or size, for parts of a capture that is not generated in parts, and for
    a cluster that cannot be used; `StorageError` when the folder cannot be written.
    """
    CAPTURES.entry(name)
    if executor not in EXECUTORS:
        raise unknown_name("executor", executor, EXECUTORS)
    if executor == "local" and cpus is not None:
        raise InputError("cores are given to tasks with --executor ray only; here OMP_NUM_THREADS says how many")
    if executor == "local" and shard is None and (processes == 1 or name not in PRESETS):
        open_capture(name, size, folder, steps)
        return ()
    capture = generated(name)
    if shard is not None and executor != "local":
        raise InputError("a shard is made by one process; leave out --shard or --executor ray")
    if not lacking(capture_folder(size, folder, capture)):
        return ()
    progress = steps(f"capture {name} {size}")
    if executor == "local" and shard is None:
        with helped(capture, size, capture_folder(size, folder, capture).absolute(), processes - 1):
            return _make(capture, size, folder, progress, None)
    if shard is None:
        _on_ray(capture, size, folder, progress, cpus)
        return ()
    return _make(capture, size, folder, progress, shard)


def _make(
    capture: CaptureName, size: str, folder: Path | None, progress: Progress, shard: Shard | None
) -> tuple[str, ...]:
    from ..data.openstage.make import make

    production = _production(capture, size)
    mine = None if shard is None else {each.key for each in shard.of(production.by_subject)}
    return make(production, capture_folder(size, folder, capture), progress, mine=mine)


@lru_cache(maxsize=1)
def _production(capture: CaptureName, size: str) -> Any:
    """The plan, made once in each process."""
    from ..data.openstage.plans import production

    return production(preset(size, capture))


def _on_ray(capture: CaptureName, size: str, folder: Path | None, progress: Progress, cpus: int | None) -> None:
    """Parts of the capture as tasks on all nodes, then what ties them together, here."""
    place = capture_folder(size, folder, capture).absolute()
    with on_cluster(cpus) as (ray, resources, slots):
        place.mkdir(parents=True, exist_ok=True)
        task = ray.remote(max_retries=3, scheduling_strategy="SPREAD", **resources)(_task)
        count = min(_PARTS * slots, len(_production(capture, size).performances))
        settings = capture, size, place.parent, resources["num_cpus"]
        waiting = [task.remote(*settings, Shard(i, count)) for i in range(1, count + 1)]
        try:
            for done in range(1, count + 1):
                (ready,), waiting = ray.wait(waiting, num_returns=1)
                try:
                    ray.get(ready)
                except ray.exceptions.RayTaskError as error:
                    raise task_failure(error) from None
                except ray.exceptions.RayError as error:
                    reason = f"its workers were lost again and again ({type(error).__name__})"
                    raise InputError(f"a part of {capture} {size} is not made: {reason}; run again") from None
                progress(done, count)
        finally:
            for left in waiting:
                ray.cancel(left, force=True)
    if _make(capture, size, folder, silent, Shard(1, 1)):
        raise InputError(f"the nodes of the Ray cluster have {place} on another disk; choose one they share")


def _task(capture: CaptureName, size: str, folder: Path, cpus: int, shard: Shard) -> Sequence[str]:
    """Runs on a node: makes one part."""
    os.environ["OMP_NUM_THREADS"] = str(cpus)
    place = capture_folder(size, folder, capture)
    if not soon(partial(Path.is_dir, place)):
        raise InputError(
            f"node {socket.gethostname()} does not see {place}; choose a folder on a disk that all nodes share"
        )
    return _make(capture, size, folder, silent, shard)
