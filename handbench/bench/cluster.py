"""Cells on the nodes of a Ray cluster (the extra `handbench[ray]`); all nodes share the disk of the run folder.

Ray's own settings say which cluster: RAY_ADDRESS, or one that runs on this machine; else Ray is started here. A
training goes first, with its first cell; then its other cells, each a task. A task whose worker or node is lost is
started elsewhere: it goes on from the lost one's checkpoints, and what was finished is not done again. Results stay
on the shared disk; only keys come back.
"""

from __future__ import annotations

import logging
import os
import re
import socket
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

from ..device import device_name, on_device
from ..errors import HandbenchError, InputError
from ..method import Progress, silent
from .executor import Done, Job, Site, work
from .plan import Cell, Plan, by_prior
from .progress import steps

_RETRIES = 3  # starts after the first, of a task whose worker was lost
_PATIENCE = 30.0  # seconds that a shared disk may take to show one machine what another wrote


def require_ray() -> Any:
    """The module ray; `InputError` if it is not installed."""
    try:
        import ray
        import ray.exceptions
    except ImportError as error:
        raise InputError("the executor ray needs Ray; install it with: pip install 'handbench[ray]'") from error
    return ray


def work_on_ray(site: Site, cells: Sequence[Cell], overall: Progress, cpus: int | None = None) -> Done:
    """`work` on all nodes. A cell gets `cpus` cores, by default all of the smallest node, so that no other disturbs it.

    Raises `InputError` for a cluster that cannot be reached, a node that does not share the run folder, and one whose
    software or data are not this machine's; a cell whose workers were lost again and again is told in `Done.lost`.
    """
    with on_cluster(cpus) as (ray, resources, _):
        task = ray.remote(max_retries=_RETRIES, scheduling_strategy="SPREAD", **resources)(_task)
        data = os.environ.get("HANDBENCH_DATA")
        job = replace(site.job, folder=site.job.folder.resolve(), data=site.job.data and site.job.data.resolve())
        about = ray.put(replace(job, command=tuple(site.job.command) or tuple(sys.argv)))

        def start(group: Sequence[Cell]) -> Any:
            return task.remote(about, device_name(), resources["num_cpus"], data, [cell.key for cell in group])

        return _drive(ray, site, cells, start, overall)


@contextmanager
def on_cluster(cpus: int | None) -> Iterator[tuple[Any, dict[str, int], int]]:
    """The module ray, connected; what a task asks of its node, and how many such tasks run at once.

    Raises `InputError` for a cluster that cannot be reached, and for a wish that no node can grant.
    """
    ray = require_ray()
    ours = not ray.is_initialized()
    if ours:
        _connect(ray)
    try:
        resources = _resources(ray, cpus)
        yield ray, resources, max(1, int(ray.cluster_resources().get("CPU", 1)) // resources["num_cpus"])
    finally:
        if ours:
            ray.shutdown()


def _drive(
    ray: Any, site: Site, cells: Sequence[Cell], start: Callable[[Sequence[Cell]], Any], overall: Progress
) -> Done:
    """Start every training, then the cells that wait for it, and take what comes back."""
    lost: dict[str, str] = {}
    done = 0
    waiting = {start(group): group for group in by_prior(cells)}
    try:
        while waiting:
            (ready,), _ = ray.wait(list(waiting), num_returns=1)
            group = waiting.pop(ready)
            try:
                settled = set(ray.get(ready))
            except ray.exceptions.RayTaskError as error:
                raise task_failure(error) from None
            except ray.exceptions.RayError as error:
                reason = f"its worker was lost {_RETRIES + 1} times ({type(error).__name__})"
                settled = {cell.key for cell in (group[:1] if site.job.store.prior(group[0].prior) else group)}
                lost |= dict.fromkeys(settled, reason)
            for cell in group:
                if cell.key not in settled:
                    waiting[start((cell,))] = (cell,)
                elif cell.key not in lost and not soon(partial(site.job.store.cell, cell.key)):
                    lost[cell.key] = f"its node has {site.job.folder} on another disk; choose a shared one with --out"
            done += len(settled)
            overall(done, len(cells))
    finally:
        for task in waiting:
            ray.cancel(task, force=True)
    return Done(len(cells) - len(lost), lost)


def task_failure(error: Any) -> Exception:
    """What a task raised, as the user should hear it; a bug keeps its traceback."""
    if isinstance(error.cause, HandbenchError):
        return error.cause
    if "failed to import on the worker" in str(error.cause):  # Ray has no type for it
        return InputError("a node of the Ray cluster cannot load handbench; install the same version on all nodes")
    return error


def _connect(ray: Any) -> None:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    address = os.environ.get("RAY_ADDRESS", "")
    try:
        if found := re.fullmatch(r"([\w.-]+):(\d+)", address):  # Ray itself would try for minutes
            socket.create_connection((found[1], int(found[2])), timeout=10).close()
        ray.init(include_dashboard=False, logging_level=logging.WARNING)
    except (OSError, OverflowError, RuntimeError, ValueError) as error:
        where = f"the Ray cluster at RAY_ADDRESS={address} cannot be reached" if address else "Ray cannot be started"
        raise InputError(f"{where} ({' '.join(str(error).split())[:300]})") from error


def _resources(ray: Any, cpus: int | None) -> dict[str, int]:
    """What a task asks of its node. A wish that no node can grant would wait for ever, so it is an `InputError`."""
    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"] and node["Resources"].get("CPU", 0) >= 1]
    cores = [int(resources["CPU"]) for resources in nodes]
    if not cores or (cpus or 1) > max(cores):
        most = max(cores, default=0)
        raise InputError(
            f"no node of the Ray cluster has {cpus or 1} cores, the most is {most}; choose fewer with --cpus"
        )
    gpus = 0 if device_name() == "cpu" else 1
    if gpus and not any(resources.get("GPU", 0) >= gpus for resources in nodes):
        raise InputError(f"no node of the Ray cluster has a GPU for device {device_name()!r}; choose --device cpu")
    return {"num_cpus": cpus or min(cores), "num_gpus": gpus}


def _task(job: Job, device: str, cpus: int, data: str | None, keys: Sequence[str]) -> list[str]:
    """Runs on a node: the first of some cells of one training, or all if that training fails. Returns their keys."""
    os.environ["OMP_NUM_THREADS"] = str(cpus)
    if data is not None:
        os.environ["HANDBENCH_DATA"] = data
    with on_device(device), steps() as told:
        site = _site(job)
        if torch := sys.modules.get("torch"):
            torch.set_num_threads(cpus)
        first, *others = (_planned(site.plan, key) for key in keys)
        work(site, [first], told, silent)
        if others and site.job.store.prior(first.prior) is not None:
            return [first.key]
        work(site, others, told, silent)
        return list(keys)


@lru_cache(maxsize=1)
def _site(job: Job) -> Site:
    """The job, opened once by each worker process. Raises `InputError` if this node does not see the run folder."""
    if not soon(lambda: job.store.run() is not None):
        raise InputError(
            f"node {socket.gethostname()} does not see the run folder {job.folder}; "
            "choose one with --out on a disk that all nodes share"
        )
    with steps() as told:
        capture = job.open_capture(told)
    return Site(job, job.plan(capture), job.make_tools(), capture)


def _planned(plan: Plan, key: str) -> Cell:
    """The cell of a key; a node that plans other keys would compute something else."""
    for cell in plan.cells:
        if cell.key == key:
            return cell
    raise InputError(
        f"node {socket.gethostname()} has other software, plug-ins or data than the machine that started the run; "
        "install the same versions and make the same capture on all nodes"
    )


def soon(seen: Callable[[], object]) -> bool:
    """Whether something on the shared disk is seen within `_PATIENCE`."""
    end = time.monotonic() + _PATIENCE
    while not seen():
        if time.monotonic() > end:
            return False
        time.sleep(0.2)
    return True
