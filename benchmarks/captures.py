"""What a capture costs to make: a random share of its poses is made, and the whole is told with an interval.

    python -m benchmarks.captures openstage --size standard --share 0.02 --out out/

makes that share of the poses (at least two) into a folder, whose pictures are there to be looked at, and tells
processor time, time by the clock, memory and disk for each view and for the whole. A view is all pictures of a pose
before one camera. `--views 2` makes two views of each pose only: the others are taken to cost what the second does,
since the first bears what all share. `--people 1` plans the first person only, where planning all takes minutes.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.stats import t as student

from handbench.data.exr import read_exr, stack
from handbench.data.openstage import generated, preset
from handbench.data.openstage.performance import Maker
from handbench.data.openstage.plans import production
from handbench.data.openstage.production import Performance
from handbench.data.openstage.trace.pathtrace import PathTracer
from handbench.evenly import evenly
from handbench.scene import Array
from handbench.scene.colour import eight_bit

SECONDS, CLOCK, BYTES = range(3)
"""What a cost (3,) counts: seconds of the processor, all cores together; by the clock; and bytes on disk."""


def costs(maker: Maker, pose: Performance, views: int | None) -> Iterator[Array]:
    """The cost (3,) of each view of a pose, or of the first few; the first bears what all share but the skin."""
    making = islice(maker.make(pose), views)
    while True:
        start = np.array([time.process_time(), time.perf_counter()])
        if (view := next(making, None)) is None:
            return
        took = np.array([time.process_time(), time.perf_counter()]) - start
        files = (maker.folder / pose.key / view.camera.name).iterdir()
        yield np.append(took, sum(path.stat().st_size for path in files))


def measure(maker: Maker, poses: Sequence[Performance], views: int | None) -> dict[str, Any]:
    """Make poses, and tell what a pose of each costs: `skin`, `poses` and `further views`, lists of costs."""
    found: dict[str, Any] = {"made": [], "skin": [], "poses": [], "further views": []}
    for pose in poses:
        start = np.array([time.process_time(), time.perf_counter()])
        maker.skin(pose.subject)
        found["skin"].append(np.append(np.array([time.process_time(), time.perf_counter()]) - start, 0.0))
        made = list(costs(maker, pose, views))
        further = made[1:] or made
        found["poses"].append(np.sum(made, axis=0) + (len(pose.views) - len(made)) * np.mean(further, axis=0))
        found["further views"] += further
        found["made"].append(f"{pose.key}: {len(made)} of {len(pose.views)} views")
        print(f"{found['made'][-1]}, {found['poses'][-1][SECONDS]:.0f} s a pose", file=sys.stderr, flush=True)
    return found


def whole(found: dict[str, Any], poses: int, views: int, people: int) -> dict[str, Any]:
    """What all poses cost, from those that were made: estimate, and the ends of its 95 % interval."""
    skin = people * np.max(found["skin"], axis=0)  # those of a person's later poses are there already
    totals = [_total([pose[kind] for pose in found["poses"]], poses) + skin[kind] for kind in range(3)]
    return {
        "made": found["made"],
        "poses, views": [poses, views],
        "processor seconds a skin": float(np.max(found["skin"], axis=0)[SECONDS]),
        "processor seconds a further view": float(np.mean(found["further views"], axis=0)[SECONDS]),
        "processor seconds a view": float(totals[SECONDS][0] / views),
        "processor hours": (totals[SECONDS] / 3600).tolist(),
        "hours by the clock": (totals[CLOCK] / 3600).tolist(),
        "megabytes a view": float(totals[BYTES][0] / views / 1e6),
        "gigabytes": (totals[BYTES] / 1e9).tolist(),
        "MiB of memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def _total(values: Sequence[float], count: int) -> Array:
    """The sum over `count` poses from a few of them: estimate, low and high (3,); not numbers for a single one."""
    mean = float(np.mean(values))
    if len(values) < 2:
        return count * np.array([mean, np.nan, np.nan])
    error = float(np.std(values, ddof=1) / math.sqrt(len(values))) * math.sqrt(max(0.0, 1.0 - len(values) / count))
    error *= float(student.ppf(0.975, len(values) - 1))
    return count * np.array([mean, max(0.0, mean - error), mean + error])


def write_pictures(folder: Path, out: Path, most: int = 24) -> None:
    """Some pictures of each view as PNG, to be looked at."""
    for view in sorted({path.parent for path in folder.rglob("*.exr")}):
        for path in evenly(sorted(path for path in view.iterdir() if path.name != "geometry.exr"), most):
            name = "--".join(path.relative_to(folder).with_suffix(".png").parts)
            Image.fromarray(eight_bit(stack(read_exr(path), ("R", "G", "B"), path))).save(out / name)


def main() -> None:
    parser = argparse.ArgumentParser(description="what a capture costs to make")
    parser.add_argument("capture")
    parser.add_argument("--size", default="standard")
    parser.add_argument("--share", type=float, default=0.02, help="of the poses that are made, two at least")
    parser.add_argument("--poses", type=int, help="how many poses are made, in place of a share")
    parser.add_argument("--views", type=int, help="how many views of each pose are made (default: all)")
    parser.add_argument("--people", type=int, help="how many people are planned (default: all)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="a folder for the pictures and the numbers")
    arguments = parser.parse_args()
    full = preset(arguments.size, generated(arguments.capture))
    people: int = vars(full)["subjects"]
    planned = min(arguments.people or people, people)
    start = time.process_time()
    plan = production(replace(full, **{"subjects": planned}))
    planning = time.process_time() - start
    every = plan.performances
    scale = people / planned
    count = arguments.poses or max(2, math.ceil(arguments.share * scale * len(every)))
    some = np.sort(np.random.default_rng(arguments.seed).choice(len(every), min(count, len(every)), replace=False))
    with tempfile.TemporaryDirectory() as folder:
        maker = Maker(plan, Path(folder), PathTracer())
        found = measure(maker, [every[i] for i in some], arguments.views)
        views = round(scale * sum(len(pose.views) for pose in every))
        told = whole(found, round(scale * len(every)), views, people) | {"processor seconds to plan": planning * scale}
        if arguments.out is not None:
            arguments.out.mkdir(parents=True, exist_ok=True)
            write_pictures(Path(folder), arguments.out)
            (arguments.out / "measured.json").write_text(json.dumps(told, indent=1))
    print(json.dumps(told, indent=1))


if __name__ == "__main__":
    main()
