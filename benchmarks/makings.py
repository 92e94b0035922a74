"""One capture made in many ways, by the real tracer: is it the same byte for byte?

    python -m benchmarks.makings openscans --size mini [--ways shards killed cluster]

makes it alone; in two shards at the same time; by a process that is killed at its first pictures, then resumed; and
with `--executor ray` on a cluster of two nodes, each with processes of its own, on this machine.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from handbench.data.openstage import capture_folder, generated
from handbench.data.openstage.presets import CaptureName

_COMMAND = [sys.executable, "-m", "handbench", "data", "make"]
_QUIET = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "disabled"}


class Making:
    """A capture and size to make, and the environment that its processes have."""

    def __init__(self, capture: CaptureName, size: str) -> None:
        self.capture, self.size = capture, size
        self.environment = {**os.environ, **_QUIET, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}

    def start(self, folder: Path, *more: str) -> subprocess.Popen[bytes]:
        command = [*_COMMAND, self.capture, "--size", self.size, "--folder", str(folder), *more]
        return subprocess.Popen(command, env=self.environment, stdout=subprocess.DEVNULL)

    def alone(self, folder: Path) -> str:
        _end(self.start(folder, "--processes", "1"))
        return ""

    def shards(self, folder: Path) -> str:
        both = [self.start(folder, "--shard", f"{i}/2") for i in (1, 2)]
        for one in both:
            _end(one)
        return "two at the same time"

    def killed(self, folder: Path) -> str:
        first = self.start(folder, "--processes", "1")
        while not (pictures := list(folder.rglob("pose-*/*/*.exr"))):
            if first.poll() is not None:
                raise RuntimeError("it ended before a picture was there")
            time.sleep(0.02)
        first.send_signal(signal.SIGKILL)
        first.wait()
        there = len(list(folder.rglob("*.exr")))
        _end(self.start(folder, "--processes", "1"))
        return f"killed with {there} files there, from {pictures[0].parent.parent.name}"

    def cluster(self, folder: Path) -> str:
        with _nodes() as (address, nodes):
            self.environment["RAY_ADDRESS"] = address
            making = self.start(folder, "--executor", "ray")
            used: set[int] = set()
            while making.poll() is None:
                used |= nodes & _parents_of_tasks()
                time.sleep(0.1)
            _end(making)
        return f"tasks on {len(used)} nodes"


@contextmanager
def _nodes() -> Iterator[tuple[str, set[int]]]:
    """A cluster of two nodes of one core each beside its head: its address, and the nodes' processes."""
    from ray.cluster_utils import Cluster

    os.environ |= _QUIET
    small = {"object_store_memory": 80 * 2**20, "include_dashboard": False}
    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, **small})
    try:
        nodes = [made.add_node(num_cpus=1, **small) for _ in range(2)]
        yield (
            made.address,
            {part.process.pid for node in nodes for each in node.all_processes.values() for part in each},
        )
    finally:
        made.shutdown()


def _parents_of_tasks() -> set[int]:
    """The processes that started what makes parts of a capture now: nodes of a cluster."""
    found = set()
    for place in Path("/proc").glob("[0-9]*"):
        try:
            if (place / "cmdline").read_bytes().startswith(b"ray::_task"):
                found.add(int((place / "stat").read_text().rpartition(")")[2].split()[1]))
        except OSError:  # it has ended meanwhile
            continue
    return found


def _end(process: subprocess.Popen[bytes]) -> None:
    if code := process.wait():
        raise RuntimeError(f"{process.args!r} ended with {code}")


def _content(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def main() -> None:
    ways = ("shards", "killed", "cluster")
    parser = argparse.ArgumentParser(description="one capture made in many ways")
    parser.add_argument("capture")
    parser.add_argument("--size", default="mini")
    parser.add_argument("--ways", nargs="+", choices=ways, default=ways)
    arguments = parser.parse_args()
    making = Making(generated(arguments.capture), arguments.size)
    with tempfile.TemporaryDirectory() as top:
        contents: dict[str, dict[str, bytes]] = {}
        for way in ("alone", *arguments.ways):
            folder = Path(top, way)
            folder.mkdir()
            told = getattr(making, way)(folder)
            contents[way] = _content(capture_folder(making.size, folder, making.capture))
            same = "equal" if contents[way] == contents["alone"] else "NOT EQUAL"
            print(f"{way}: {len(contents[way])} files, {same}{told and f' ({told})'}", flush=True)


if __name__ == "__main__":
    main()
