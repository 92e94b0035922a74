"""Seconds and memory to list the frames of a large capture: `python -m benchmarks.listing`.

A temporary folder of InterHand2.6M's layout with a million names (links to one picture), 80 cameras before 12,500
moments of a hand that MANO is said to be fitted to, is read by a process of its own. MANO's file is one of that
structure made of the open hand, as tests make it.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

CAMERAS, GOAL_S, GOAL_MB = 80, 5.0, 1000.0
MOST_LINKS = 30_000

READ = """
import resource, sys, time
from pathlib import Path
from handbench.data.readers import open_at
from handbench.data.readers.mano import right_hand
right_hand()
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
start, used = time.perf_counter(), time.process_time()
capture = open_at(Path(sys.argv[1]))
count = len(capture.frames())
took, used = time.perf_counter() - start, time.process_time() - used
more = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
offers = time.process_time()
capture.offers
offers = time.process_time() - offers
print(count, took, used, more / 1024, offers)
"""

WRITE_MANO = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
import syntheticmano
syntheticmano.write(Path(sys.argv[1]))
"""


def write(folder: Path, names: int) -> None:
    """The layout with so many names, all of one capture and sequence."""
    numbers = [str(10000 + 3 * i) for i in range(max(1, names // CAMERAS))]
    root = folder / "images" / "train" / "Capture0" / "ROM03_RT_No_Occlusion"
    cameras = [str(400000 + i) for i in range(CAMERAS)]
    linked, left = folder / "0.jpg", 0
    for camera in cameras:
        place = root / f"cam{camera}"
        place.mkdir(parents=True)
        for number in numbers:
            if left == 0:
                linked = folder / f"{len(list(folder.glob('*.jpg')))}.jpg"
                Image.new("RGB", (334, 512)).save(linked)
                left = MOST_LINKS
            os.link(linked, f"{place}/image{number}.jpg")
            left -= 1
    fit = {"pose": [0.01] * 48, "shape": [0.1] * 10, "trans": [0.0, 0.0, 0.5]}
    point = {"world_coord": [[0.0, 0.0, 500.0]] * 42, "joint_valid": [[1]] * 42, "hand_type": "right"}
    said = {
        "camera": {
            "campos": {camera: [0.0, 0.0, 0.0] for camera in cameras},
            "camrot": {camera: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] for camera in cameras},
            "focal": {camera: [1000.0, 1000.0] for camera in cameras},
            "princpt": {camera: [167.0, 256.0] for camera in cameras},
        },
        "joint_3d": dict.fromkeys(numbers, point),
        "MANO_NeuralAnnot": {number: {"right": fit, "left": None} for number in numbers},
    }
    notes = folder / "annotations" / "train"
    notes.mkdir(parents=True)
    for kind, table in said.items():
        (notes / f"InterHand2.6M_train_{kind}.json").write_text(json.dumps({"0": table}))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.listing", description=__doc__)
    parser.add_argument("--names", type=int, default=1_000_000, help="pictures (default: 1,000,000)")
    parser.add_argument("--times", type=int, default=3, help="how often it is read (default: 3)")
    arguments = parser.parse_args()
    tests = Path(__file__).parents[1] / "tests"
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "interhand"
        write(folder, arguments.names)
        subprocess.run([sys.executable, "-c", WRITE_MANO, f"{made}/mano", str(tests)], check=True)
        env = {**os.environ, "HANDBENCH_MANO": f"{made}/mano"}
        for _ in range(arguments.times):
            told = subprocess.run([sys.executable, "-c", READ, str(folder)], check=True, capture_output=True, env=env)
            count, wall, used, memory, offers = map(float, told.stdout.split())
            print(
                f"{count:,.0f} frames: {wall:.2f} s ({used:.2f} s of processor time; goal {GOAL_S:g} s), "
                f"{memory:.0f} MB (goal {GOAL_MB:g} MB); what they offer: {offers:.2f} s"
            )


main()
