"""Make handbench/data/openstage/thumbnails.npz anew: small pictures of a few fixed views of each preset.

Run after the last change of what is generated, with the generator's version raised:

    .venv/bin/python maintainer/thumbnails.py                    all that are small enough
    .venv/bin/python maintainer/thumbnails.py openscans-mini     some; the others stay as they are
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from handbench.data.openstage import PRESETS
from handbench.data.openstage.performance import Maker
from handbench.data.openstage.plans import production
from handbench.data.openstage.presets import Preset
from handbench.data.openstage.thumbnails import KEPT, chosen, thumbnail
from handbench.data.openstage.trace.pathtrace import PathTracer

SMALL = ("mini", "quick", "dense")


def pictures(preset: Preset) -> dict[str, np.ndarray]:
    """The thumbnails of a preset by recipe and path."""
    plan, found = production(preset), {}
    with tempfile.TemporaryDirectory() as folder:
        maker = Maker(plan, Path(folder), PathTracer())
        for performance, name in chosen(plan):
            for _ in maker.make(performance):
                found[f"{preset.recipe}/{name}"] = thumbnail(Path(folder) / name).astype(np.float16)
    return found


def main(names: list[str]) -> None:
    presets = [preset for sizes in PRESETS.values() for preset in sizes.values() if preset.name in SMALL]
    kept = dict(np.load(KEPT)) if KEPT.is_file() else {}
    found: dict[str, np.ndarray] = {}
    for preset in presets:
        if not names or f"{preset.capture}-{preset.name}" in names:
            found |= pictures(preset)
            print(preset.label, flush=True)
        else:
            found |= {name: image for name, image in kept.items() if name.startswith(preset.recipe)}
    np.savez_compressed(KEPT, **found)
    print(f"{KEPT}: {len(found)} pictures, {KEPT.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
