"""Which files make up an open light stage, whether they are all there, and a digest of their content."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

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


def content(folder: Path, manifest: dict[str, Any]) -> str:
    """A digest of all files of a whole capture."""
    total = hashlib.sha256()
    for name in files(manifest):
        total.update(name.encode() + hashlib.sha256((folder / name).read_bytes()).digest())
    return total.hexdigest()[:16]
