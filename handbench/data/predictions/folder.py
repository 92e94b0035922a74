"""A prediction folder against what a protocol asks: everything that is wrong is found before anything is scored."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ...errors import InputError
from ...scene import Query
from ..predictionfiles import nested_path
from .manifest import COLOUR, MANIFEST, SUFFIXES, TIMES, DeclaredTimes, PredictionManifest, read_manifest, read_times
from .picture import UnfitPicture, read_picture, what_is_not_finite
from .problems import Problems, Unfit

ASKED = "asked"  # the folder of the template
_FREE = ("readme", "license", "licence")


@dataclass(frozen=True)
class Asked:
    """What a protocol asks: the manifest that an answer must have, without its authors, and the queries by key."""

    manifest: PredictionManifest
    queries: Mapping[str, Query]

    @staticmethod
    def of(protocol: str, protocol_digest: str, capture_digest: str, queries: Iterable[Query]) -> Asked:
        """From the protocol's name@version, the digests and the queries as a method is asked them."""
        return Asked(
            PredictionManifest(protocol, protocol_digest, capture_digest), {query.key: query for query in queries}
        )


@dataclass(frozen=True)
class PredictionFolder:
    """A folder that was found fit: `digest` covers every byte that decides a result."""

    path: Path
    manifest: PredictionManifest
    times: DeclaredTimes | None
    digest: str


def read_folder(folder: Path, asked: Asked, allow_missing: bool = False) -> PredictionFolder:
    """Check a folder. Raises `Unfit` with all that is wrong, and `InputError` if there is no such folder.

    With `allow_missing`, queries without a picture and pictures with NaN are no fault: their scores have a reason.
    """
    if not folder.is_dir():
        raise InputError(f"there is no prediction folder {folder}; check its path")
    problems = Problems()
    manifest = read_manifest(folder, asked.manifest, problems)
    times = read_times(folder, asked.queries, problems)
    suffix = SUFFIXES[COLOUR] if manifest is None else manifest.suffix
    present, linked = _files(folder.resolve(), asked, suffix, problems)
    digest = hashlib.sha256()
    for name in (MANIFEST, TIMES):
        if (folder / name).is_file():
            digest.update((folder / name).read_bytes() + b"\0")
    for key, query in asked.queries.items():
        path = nested_path(folder, key, suffix)
        if key not in present:
            if key not in linked and not allow_missing:
                problems.add("missing", f"{key}{suffix}")
            continue
        try:
            bad = what_is_not_finite(read_picture(path, query.camera))
        except UnfitPicture as error:
            problems.add(error.kind, f"{key}{suffix} {error}")
            continue
        if bad and not allow_missing:
            problems.add("non-finite", f"{key}{suffix}: {bad}")
        digest.update(f"{key}\0{hashlib.sha256(path.read_bytes()).hexdigest()}\0".encode())
    if not present and not problems:
        problems.add("missing", "there is not one picture")
    if problems or manifest is None:
        raise Unfit(f"prediction folder {folder}", problems)
    return PredictionFolder(folder, manifest, times, digest.hexdigest())


def _files(folder: Path, asked: Asked, suffix: str, problems: Problems) -> tuple[set[str], set[str]]:
    """The queries that have a file, and those whose file is a link that leaves the folder.

    Such links, links to folders, and names that mean nothing are problems.
    """
    wanted = {f"{key}{suffix}": key for key in asked.queries}
    otherwise = {f"{key}{other}": colour for key in asked.queries for colour, other in SUFFIXES.items()}
    folded = {name.casefold(): name for name in wanted}
    present: set[str] = set()
    linked: set[str] = set()
    strange: list[str] = []
    for parent, folders, names in os.walk(folder):
        here = Path(parent)
        folders[:] = sorted(name for name in folders if not name.startswith(".") and (here / name) != folder / ASKED)
        for name in (*folders, *sorted(names)):
            path = here / name
            relative = path.relative_to(folder).as_posix()
            if path.is_symlink() and (name in folders or _leaves(path, folder)):
                problems.add("link", f"{relative} points to {path.readlink()}")
                linked.add(wanted.get(relative, ""))
            elif relative in wanted:
                present.add(wanted[relative])
            elif name not in folders and not name.startswith(".") and not _free(relative):
                strange.append(relative)
    for name in strange:
        twin = folded.get(name.casefold())
        if twin is not None and wanted[twin] in present:
            problems.add("duplicate", f"{name} beside {twin}")
        else:
            hint = f" (did you mean {twin}?)" if twin else ""
            if name in otherwise:
                hint = f" (where manifest.json says that colour is {otherwise[name]!r} it is read)"
            problems.add("unexpected", name + hint)
    return present, linked


def _leaves(link: Path, folder: Path) -> bool:
    try:
        return not link.resolve().is_relative_to(folder)
    except (OSError, RuntimeError):  # a link that leads to itself
        return True


def _free(relative: str) -> bool:
    """Whether a file is none of ours and no mistake either."""
    if "/" in relative:
        return False
    return relative in (MANIFEST, TIMES) or relative.lower().startswith(_FREE)
