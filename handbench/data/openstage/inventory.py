"""Which files make up an open light stage, whether they are all there, and a digest of their content."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from ...errors import InputError
from ...files import whole

SUMS = "sums.json"
TRACED = ("olat", "environment")  # kinds of lighting that are rendered; the others are sums


def olat_name(number: int) -> str:
    """The name of the lighting by one stage light alone, and of its images."""
    return f"olat-{number:02d}"


def files(manifest: dict[str, Any]) -> Iterator[str]:
    """Paths below the capture's folder, in a fixed order; capture.json itself is not among them."""
    yield "topology.npz"
    traced = [entry["name"] for entry in manifest["lightings"] if entry["kind"] in TRACED]
    for entry in manifest["lightings"]:
        if entry["kind"] == "environment":
            yield f"environments/{entry['name']}.exr"
    for person in manifest["subjects"]:
        for act in person["poses"]:
            pose = f"{person['name']}/{act['name']}"
            yield f"{pose}/tracked.npy"
            for camera in manifest["cameras"]:
                yield from (f"{pose}/{camera['name']}/{name}.exr" for name in (*traced, "geometry"))


def missing(folder: Path, manifest: dict[str, Any]) -> list[str]:
    """The capture's files that are not there."""
    return [name for name in files(manifest) if not (folder / name).is_file()]


def content(sums: Mapping[str, str]) -> str:
    """A digest of a whole capture from the SHA-256 of each of its files, in their order."""
    total = hashlib.sha256()
    for name, digest in sums.items():
        total.update(name.encode() + bytes.fromhex(digest))
    return total.hexdigest()[:16]


def measured(folder: Path, manifest: dict[str, Any]) -> dict[str, str]:
    """The SHA-256 of each file as it is now."""
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in files(manifest)}


def write_sums(folder: Path, sums: Mapping[str, str]) -> None:
    with whole(folder / SUMS) as part:
        part.write_text(json.dumps(sums, indent=0))


def recorded(folder: Path, manifest: dict[str, Any]) -> dict[str, str]:
    """The SHA-256 of each file as it was generated: kept in a file that the manifest's digest vouches for.

    Where that is missing or damaged all files are looked at. Raises `InputError` if they are not what was generated.
    """
    with suppress(OSError, ValueError, AttributeError, TypeError):
        kept = json.loads((folder / SUMS).read_text())
        sums = {name: kept[name] for name in files(manifest) if name in kept}
        if content(sums) == manifest["content"]:
            return sums
    sums = measured(folder, manifest)
    if content(sums) != manifest["content"]:
        raise InputError(f"files of {folder} are not what was generated; delete it and make the capture again")
    with suppress(OSError):  # a folder that cannot be written is looked at again next time
        write_sums(folder, sums)
    return sums
