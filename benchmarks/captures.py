"""What a capture costs to make: a random share of its poses is made, and the whole is told with an interval.

    python -m benchmarks.captures openstage --size standard --share 0.02 --out out/

makes that share of the poses (at least two) with all their views into a folder, whose pictures are there to be looked
at, and tells time, memory and disk for each view and for the whole.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.stats import t as student

from handbench.data.exr import read_exr, stack
from handbench.data.openstage import generated, preset
from handbench.data.openstage.performance import Maker
from handbench.data.openstage.plans import production
from handbench.data.openstage.production import Production
from handbench.data.openstage.trace.pathtrace import PathTracer
from handbench.scene.colour import eight_bit


def measure(plan: Production, share: float, seed: int, folder: Path) -> dict[str, Any]:
    """Make a random share of a production's poses: seconds, bytes and MiB, a view and for the whole (95 %)."""
    every = plan.performances
    rng = np.random.default_rng(seed)
    some = sorted(rng.choice(len(every), max(2, math.ceil(share * len(every))), replace=False))
    maker, skins, seconds, sizes, views = Maker(plan, folder, PathTracer()), [], [], [], []
    for i in some:
        start = time.perf_counter()
        maker.skin(every[i].subject)
        skins.append(time.perf_counter() - start)
        start = time.perf_counter()
        views.append(len(list(maker.make(every[i]))))
        seconds.append(time.perf_counter() - start)
        files = [path for path in (folder / every[i].key).rglob("*") if path.is_file()]
        sizes.append(sum(path.stat().st_size for path in files))
    skin = float(max(skins)) * len(plan.by_subject)  # those of the same subject are there already
    return {
        "poses made": [every[i].key for i in some],
        "views": sum(len(one.views) for one in every),
        "seconds a view": float(np.sum(seconds) / np.sum(views)),
        "hours": [(low + skin) / 3600 for low in _total(seconds, len(every))],
        "kilobytes a view": float(np.sum(sizes) / np.sum(views) / 1e3),
        "gigabytes": [low / 1e9 for low in _total(sizes, len(every))],
        "MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def _total(values: list[float], count: int) -> list[float]:
    """The sum over all poses: estimate, and the ends of its 95 % interval, from a few of them."""
    mean, error = float(np.mean(values)), float(np.std(values, ddof=1) / math.sqrt(len(values)))
    error *= math.sqrt(max(0.0, 1.0 - len(values) / count)) * float(student.ppf(0.975, len(values) - 1))
    return [count * mean, count * max(0.0, mean - error), count * (mean + error)]


def write_pictures(folder: Path, out: Path) -> None:
    """Every picture as PNG, to be looked at."""
    for path in sorted(folder.rglob("*.exr")):
        if path.name != "geometry.exr":
            name = "--".join(path.relative_to(folder).with_suffix(".png").parts)
            Image.fromarray(eight_bit(stack(read_exr(path), ("R", "G", "B"), path))).save(out / name)


def main() -> None:
    parser = argparse.ArgumentParser(description="what a capture costs to make")
    parser.add_argument("capture")
    parser.add_argument("--size", default="standard")
    parser.add_argument("--share", type=float, default=0.02, help="of the poses that are made")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="a folder for the pictures and the numbers")
    arguments = parser.parse_args()
    start = time.perf_counter()
    plan = production(preset(arguments.size, generated(arguments.capture)))
    planned = time.perf_counter() - start
    with tempfile.TemporaryDirectory() as folder:
        found = measure(plan, arguments.share, arguments.seed, Path(folder)) | {"seconds to plan": planned}
        if arguments.out is not None:
            arguments.out.mkdir(parents=True, exist_ok=True)
            write_pictures(Path(folder), arguments.out)
            (arguments.out / "measured.json").write_text(json.dumps(found, indent=1))
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
