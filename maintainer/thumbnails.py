"""Make handbench/data/openstage/thumbnails.npz anew from captures that were made here.

Run after the last change of what a version of the generator makes, before maintainer/make_mini.sh:

    .venv/bin/python maintainer/thumbnails.py ~/.cache/handbench

takes every finished capture in the folder that is of a recipe of today and at most a few gigabytes large; what the file
holds of other recipes of today stays.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from handbench.data.openstage import PRESETS
from handbench.data.openstage.manifest import FILE, read_manifest
from handbench.data.openstage.thumbnails import KEPT, chosen, thumbnail
from handbench.errors import InputError

SMALL = ("mini", "quick", "dense")


def main(folder: Path) -> None:
    recipes = {preset.recipe for sizes in PRESETS.values() for preset in sizes.values() if preset.name in SMALL}
    kept = dict(np.load(KEPT)) if KEPT.is_file() else {}
    found = {name: image for name, image in kept.items() if name.partition("/")[0] in recipes}
    for path in sorted(folder.glob(f"*/{FILE}")):
        try:
            manifest = read_manifest(path)
        except InputError as error:
            print(f"left out: {error}")
            continue
        if (recipe := manifest["recipe"]) in recipes:
            found |= {f"{recipe}/{name}": thumbnail(path.parent / name).astype(np.float16) for name in chosen(manifest)}
            print(path.parent.name, flush=True)
    np.savez_compressed(KEPT, **found)
    print(f"{KEPT}: {len(found)} pictures, {KEPT.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
