"""Generation of a capture: path traced pose by pose, by any number of processes, resumable, nothing half-written.

A process claims a pose before it makes it, so that two never render the same view. What is made depends on the
production alone: not on who makes it, in what order, or how often it was stopped.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ...claims import claim
from ...errors import InputError, StorageError
from ...files import JSON_LIMIT, read_json, whole, writing
from ...method import Progress, silent
from ...scene import Environment
from ..exr import rgb, write_exr
from .describe import describe
from .inventory import checksums, content, files, pose_files, recorded, shared_files, write_sums
from .manifest import FILE, Manifest, read_manifest
from .performance import Maker
from .production import Performance, Production
from .thumbnails import difference
from .trace.pathtrace import PathTracer

BEGUN = "begun.json"  # which recipe a folder was begun with
_LATELY = 600.0  # seconds: no file takes as long to write
_FINISHED = 10.0  # seconds: once all files are there nobody writes them, but on a disk without locks
_LONGEST_PAUSE = 5.0  # seconds between looks at what other processes have made


def make(
    production: Production,
    folder: Path,
    progress: Progress = silent,
    mine: Collection[str] | None = None,
    finish: bool = True,
) -> tuple[str, ...]:
    """Generate what is missing of a capture in `folder`; its capture.json is written last.

    `mine` are the keys of the performances to make, None for all. What another process is at work on is left to it,
    and waited for. Returns the keys of performances of others that are not there yet; without any the capture is
    finished, unless `finish` leaves that to another.
    Raises `StorageError` when the folder cannot be written or the disk is full, what is there stays; `InputError` if
    the folder was begun with another recipe, and if pictures are too far from the package's.
    """
    with writing(folder, "free some space or choose another folder"):
        folder.mkdir(parents=True, exist_ok=True)
        _check_space(production, folder)
        _begin(production, folder)
        _sweep(folder, _LATELY)
        manifest = describe(production)
        lost = frozenset(name for name in files(manifest) if not (folder / name).is_file())
        _save_shared(production, folder, manifest)
        chosen = [one for one in production.performances if mine is None or one.key in mine]
        _work(Maker(production, folder, PathTracer()), chosen, _files_of(folder, manifest), progress)
        left = tuple(key for key, paths in _files_of(folder, manifest).items() if not _all_there(paths))
        if finish and not left:
            _sweep(folder, _FINISHED)
            _finish(folder, manifest, lost)
        return left


def _begin(production: Production, folder: Path) -> None:
    """Note which recipe a folder is of, so that none is made of two."""
    note, recipe = folder / BEGUN, production.preset.recipe
    if not note.is_file():
        with whole(note) as part:
            part.write_text(json.dumps({"recipe": recipe}))
    begun = read_json(note, JSON_LIMIT, "note")
    if not isinstance(begun, dict) or begun.get("recipe") != recipe:
        raise InputError(
            f"{folder} was begun with another preset or generator than this version's; delete it and run again"
        )


def _sweep(folder: Path, lately: float) -> None:
    """Remove what killed processes left half-written. What was touched lately, in seconds, may be another's."""
    for part in folder.rglob(".*.part"):
        with suppress(OSError):
            if time.time() - part.stat().st_mtime > lately:
                part.unlink()


def _save_shared(production: Production, folder: Path, manifest: Manifest) -> None:
    """Topology and environments: what all poses have in common."""
    maps = {f"environments/{lit.name}.exr": lit.light for lit in production.lightings}
    for name in shared_files(manifest):
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        if path.is_file():
            continue
        if isinstance(light := maps.get(name), Environment):
            write_exr(path, rgb(light.radiance, dtype=np.float32))
            continue
        topology = production.hand.topology(production.mesh_level)
        uvs, uv_faces = topology.unwrapped
        with whole(path) as part, part.open("wb") as file:
            np.savez_compressed(file, faces=topology.faces, uvs=uvs.astype(np.float32), uv_faces=uv_faces)


def _files_of(folder: Path, manifest: Manifest) -> dict[str, list[Path]]:
    """The files of every performance, by its key."""
    return {
        f"{person['name']}/{pose['name']}": [folder / name for name in pose_files(manifest, person["name"], pose)]
        for person in manifest["subjects"]
        for pose in person["poses"]
    }


def _all_there(paths: Sequence[Path]) -> bool:
    return all(path.is_file() for path in paths)


def _work(maker: Maker, performances: Sequence[Performance], paths: dict[str, list[Path]], progress: Progress) -> None:
    """Make performances, each in one process only, and wait for those that other processes are at."""
    total = sum(len(one.views) for one in performances)
    left, done, pause = list(performances), 0, 0.1
    while left:
        later: list[Performance] = []
        for performance in left:
            with claim(maker.folder / "claims" / performance.key.replace("/", "--")) as ours:
                if not ours:
                    later.append(performance)
                    continue
                for _ in _made(maker, performance, _all_there(paths[performance.key])):
                    done += 1
                    progress(done, total)
            # what others have made meanwhile counts as soon as it is there: the time that is left depends on it
            made = [other for other in later if _all_there(paths[other.key])]
            later = [other for other in later if other not in made]
            if made:
                done += sum(len(other.views) for other in made)
                progress(done, total)
        if len(later) < len(left):
            pause = 0.1
        else:
            time.sleep(pause)
            pause = min(2 * pause, _LONGEST_PAUSE)
        left = later
    with suppress(OSError):  # others may be at work
        (maker.folder / "claims").rmdir()


def _made(maker: Maker, performance: Performance, there: bool) -> Iterator[object]:
    """One step a view, whether it is made now or was there."""
    return iter(performance.views) if there else maker.make(performance)


def _finish(folder: Path, manifest: Manifest, lost: Collection[str]) -> None:
    """Write the sums and capture.json. Of files that were there before, the sums that vouch for them stay."""
    off = difference(manifest, folder)
    before: dict[str, str] = {}
    with suppress(InputError, OSError):
        before = recorded(folder, read_manifest(folder / FILE))
    names = list(files(manifest))
    fresh = checksums(folder, [name for name in names if name in lost or name not in before])
    sums = {name: fresh.get(name) or before[name] for name in names}
    write_sums(folder, sums)
    with whole(folder / FILE) as part:
        told = {"difference": None if off is None else asdict(off), "content": content(sums)}
        part.write_text(json.dumps(manifest | told, indent=1))


def _check_space(production: Production, folder: Path) -> None:
    """Refuse early when the disk cannot hold what is missing: half floats, compressed to about half."""
    preset = production.preset
    images = sum(
        len(view.lightings) + 3
        for performance in production.performances
        for view in performance.views
        if not (folder / performance.key / view.camera.name / "geometry.exr").is_file()
    )
    need, free = images * preset.height * preset.width * 3, shutil.disk_usage(folder).free
    if free < need:
        raise StorageError(
            f"{folder} has {free / 1e9:.2f} GB free, {preset.label} needs about {need / 1e9:.2f} GB more; "
            "free some space or keep captures elsewhere"
        )
