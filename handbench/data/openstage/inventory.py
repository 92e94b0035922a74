"""Which files make up a capture, whether they are all there, and digests of their content."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from ...errors import InputError
from ...files import whole

SUMS = "sums.json"


def olat_name(number: int) -> str:
    """The name of the lighting by one stage light alone, and of its images."""
    return f"olat-{number:02d}"


def files(manifest: Mapping[str, Any]) -> Iterator[str]:
    """Paths below the capture's folder, in a fixed order; capture.json itself is not among them."""
    yield from shared_files(manifest)
    for person in manifest["subjects"]:
        for pose in person["poses"]:
            yield from pose_files(manifest, person["name"], pose)


def shared_files(manifest: Mapping[str, Any]) -> Iterator[str]:
    """Those that belong to no pose: the topology of meshes and the environments."""
    if manifest["meshes"] is not None:
        yield "topology.npz"
    for entry in manifest["lightings"]:
        if entry["kind"] == "environment":
            yield f"environments/{entry['name']}.exr"


def pose_files(manifest: Mapping[str, Any], subject: str, pose: Mapping[str, Any]) -> Iterator[str]:
    """Those of one pose of a subject: its mesh, then camera by camera the traced pictures and the geometry."""
    folder = f"{subject}/{pose['name']}"
    if manifest["meshes"] is not None:
        yield f"{folder}/{manifest['meshes']}.npy"
    traced = [entry["name"] for entry in manifest["lightings"] if entry["kind"] == "olat" or entry["weights"] is None]
    views: dict[str, dict[str, None]] = {}
    for shot in pose["shots"]:
        names = traced if shot["lightings"] is None else [name for name in shot["lightings"] if name in set(traced)]
        for camera in shot["cameras"] or [camera["name"] for camera in manifest["cameras"]]:
            views.setdefault(camera, {}).update(dict.fromkeys(names))
    for camera, lightings in views.items():
        yield from (f"{folder}/{camera}/{name}.exr" for name in (*lightings, "geometry"))


def missing(folder: Path, manifest: Mapping[str, Any]) -> list[str]:
    """The capture's files that are not there."""
    return [name for name in files(manifest) if not (folder / name).is_file()]


def content(sums: Mapping[str, str]) -> str:
    """A digest of a whole capture from the SHA-256 of each of its files, in their order."""
    total = hashlib.sha256()
    for name, digest in sums.items():
        total.update(name.encode() + bytes.fromhex(digest))
    return total.hexdigest()[:16]


def checksums(folder: Path, names: Collection[str]) -> dict[str, str]:
    """The SHA-256 of each file as it is now."""
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in names}


def write_sums(folder: Path, sums: Mapping[str, str]) -> None:
    with whole(folder / SUMS) as part:
        part.write_text(json.dumps(sums, indent=0))


def recorded(folder: Path, manifest: Mapping[str, Any]) -> dict[str, str]:
    """The SHA-256 of each file as it was generated: kept in a file that the manifest's content vouches for.

    Where that is missing or damaged all files are looked at. Raises `InputError` if they are not what was generated.
    """
    names = list(files(manifest))
    with suppress(OSError, ValueError, AttributeError, TypeError):
        kept = json.loads((folder / SUMS).read_text())
        sums = {name: kept[name] for name in names if name in kept}
        if content(sums) == manifest["content"]:
            return sums
    sums = checksums(folder, names)
    if content(sums) != manifest["content"]:
        raise InputError(f"files of {folder} are not what was generated; delete it and make the capture again")
    with suppress(OSError):  # a folder that cannot be written is looked at again next time
        write_sums(folder, sums)
    return sums
