"""What handbench keeps on disk, how large it is, and what of it can go.

In the cache folder: captures that were generated, shadows, digests of files. In a run folder: cells, pictures and
trainings of the last plan, and what earlier plans left there.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from .cache import cache_folder
from .errors import unknown_name
from .files import writing

_KINDS = {"shadows": "shadows that were traced; traced again when they are needed", "digests.json": "digests of files"}
_PARTS = {
    "cells": "results of cells",
    "predictions": "pictures of cells",
    "priors": "trainings",
    "checkpoints": "trainings under way",
    "report": "the report",
}


@dataclass(frozen=True)
class Kept:
    """Something on disk. `left`: of it, what no plan needs, and `left_bytes` of that."""

    name: str
    what: str
    bytes: int
    paths: tuple[Path, ...]
    left: tuple[Path, ...] = ()

    @property
    def left_bytes(self) -> int:
        return sum(map(size, self.left))


def in_cache(folder: Path | None = None) -> list[Kept]:
    """What lies in the cache folder, the largest first; [] if there is none."""
    folder = folder or cache_folder()
    entries = sorted(path for path in folder.iterdir() if not path.name.startswith(".")) if folder.is_dir() else []
    found = [Kept(path.name, _kind(path), size(path), (path,)) for path in entries]
    return sorted(found, key=lambda each: -each.bytes)


def in_run(folder: Path) -> list[Kept]:
    """What lies in a run folder, part by part, with what the plan of run.json does not need.

    Raises `InputError` for a folder without a run.
    """
    from .results.reading import read_run

    run = read_run(folder)
    cells = set(run.plan.cells)
    priors = {cell.prior for cell in run.cells if cell.prior is not None}
    complete = len(run.cells) == len(cells)
    needed: dict[str, set[str] | None] = {"cells": cells, "predictions": cells, "priors": priors}
    needed |= {"checkpoints": cells | priors, "report": None}
    found = []
    for part, what in _PARTS.items():
        entries = tuple(sorted(run.store.own(folder / part).glob("[!.]*")))
        keys = needed[part]
        # before all cells are there nobody knows which trainings they need
        known = keys is not None and (complete or part in ("cells", "predictions"))
        left = tuple(path for path in entries if known and keys is not None and path.stem not in keys)
        found.append(Kept(part, what, sum(map(size, entries)), entries, left))
    return found


def entries_named(names: Iterable[str], kept: Iterable[Kept]) -> list[Kept]:
    """The entries of some names. Raises `InputError` for an unknown one."""
    by_name = {each.name: each for each in kept}
    for name in names:
        if name not in by_name:
            raise unknown_name("entry of the cache", name, by_name)
    return [by_name[name] for name in dict.fromkeys(names)]


def remove(paths: Iterable[Path]) -> int:
    """Remove files and folders; how many bytes that frees. A link goes, not what it leads to."""
    freed = 0
    for path in paths:
        freed += size(path)
        with writing(path, "remove it yourself"):
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink()
    return freed


def size(path: Path) -> int:
    """Bytes of a file, or of all files below a folder; links count nothing."""
    if path.is_symlink():
        return 0
    try:
        return sum(map(size, path.iterdir())) if path.is_dir() else path.stat().st_size
    except FileNotFoundError:  # gone meanwhile
        return 0


def bytes_told(count: int) -> str:
    """Bytes for people: "1.4 GB"."""
    value = float(count)
    for unit in ("B", "kB", "MB"):
        if value < 999.5:  # which is told as 1000
            return f"{value:.3g} {unit}"
        value /= 1000
    return f"{value:.3g} GB"


def is_run(name: str) -> bool:
    """Whether a name is the path of a run folder."""
    return (Path(name) / "run.json").is_file()


def _kind(path: Path) -> str:
    if path.name in _KINDS:
        return _KINDS[path.name]
    return "a capture; made again when it is needed" if _is_capture(path) else "made again when it is needed"


def _is_capture(path: Path) -> bool:
    return path.is_dir() and any((path / name).exists() for name in ("capture.json", "begun.json"))
