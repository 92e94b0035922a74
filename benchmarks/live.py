"""Frames a second of the live viewer: `python -m benchmarks.live`.

The viewer's own server draws 256 x 342 pictures of `urhand` and `physical` at texture 128 under a sky box, asked by one
client over HTTP, one picture after the other as the page asks: the camera goes around, the light turns, both, poses
follow one another, ones that were shown before and new ones. Each is measured for whole pictures and for the drafts
(half as many pixels both ways, few lights) that the page asks for while something moves and whole ones are slow.
Weights are not trained unless a run is named (`--run RUN`), which costs the same.
"""

from __future__ import annotations

import argparse
import http.client
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from rich.console import Console
from rich.table import Table

from handbench.avatars.making import from_run
from handbench.avatars.portrait import Portrait
from handbench.avatars.repertoire import Repertoire
from handbench.bench.plan import make_method
from handbench.data.lights import NamedLight
from handbench.method import Progress, silent
from handbench.recording import Recording
from handbench.registry import CAPTURES
from handbench.registry import METHODS as KNOWN
from handbench.viewer.server import Server
from handbench.viewer.session import KEPT, Session

from .poses import priors

SIZE, GOAL = (256, 342), 8.0  # width and height, frames a second on two cores
METHODS = ("urhand", "physical")
MAPS = ("hall", "park")


@dataclass(frozen=True)
class Live:
    """What was measured of one kind of movement: milliseconds of each picture, and of processor time."""

    avatar: str
    moves: str
    draft: bool
    wall_ms: list[float]
    used_ms: float

    @property
    def rate(self) -> float:
        return 1e3 / median(self.wall_ms)


def untrained(size: str) -> list[Portrait]:
    """A subject of an openstage capture, generated if missing."""
    capture = CAPTURES.load("openstage")(size)
    every = capture.frames()
    subject = every[0].subject
    own = [frame for frame in every if frame.subject == subject]
    enrolment = Recording([frame for frame in own if frame.kind == "full"][:4], capture.observe)
    shown = Repertoire.of([frame.query for frame in own], None, {})
    found = []
    for name, (prior, _) in priors(len(every[0].pose.joints)).items():
        if name in METHODS:
            info = make_method(KNOWN.entry(name), "quick").info
            about = ("quick", {}, prior, prior.personalise(enrolment), shown, "untrained", "none", name)
            found.append(Portrait(name, info, *about))
    return found


def of_run(folder: Path) -> list[Portrait]:
    def told(label: str) -> Progress:
        return silent

    return [from_run(folder, name, None, told) for name in METHODS]


def moves(poses: int, frames: int) -> dict[str, Iterator[str]]:
    """Queries of the page, by what moves."""
    turns = [3.0 * i for i in range(1, frames + 1)]
    return {
        "camera": (f"yaw={turn}" for turn in turns),
        "light": (f"turn={turn}" for turn in turns),
        "camera and light": (f"yaw={turn}&turn={turn}" for turn in turns),
        "pose shown before": (f"pose={i % poses}&turn={turn}" for i, turn in enumerate(turns, start=1)),
        "new pose": (f"pose={i % poses}&turn={turn}" for i, turn in enumerate(turns, start=1)),
    }


def measured(portraits: list[Portrait], frames: int) -> list[Live]:
    session = Session(portraits, [NamedLight(name) for name in MAPS], SIZE)
    found = []
    with Server(session) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        link = http.client.HTTPConnection("127.0.0.1", server.server_port)
        for number, portrait in enumerate(portraits):
            poses = len(session.postures[number])
            for draft in (False, True):
                wanted = f"avatar={number}&draft={int(draft)}"
                for pose in range(poses):  # the first picture finds the exposure, and of each pose what is kept
                    _ask(link, f"{wanted}&pose={pose}")
                for name, queries in moves(poses, frames).items():
                    session.kept = 1 if name == "new pose" else KEPT
                    walls, used = [], time.process_time()
                    for query in queries:
                        start = time.perf_counter()
                        _ask(link, f"{wanted}&{query}")
                        walls.append(1e3 * (time.perf_counter() - start))
                    each = 1e3 * (time.process_time() - used) / len(walls)
                    found.append(Live(portrait.name, name, draft, walls[1:], each))
        server.shutdown()
    return found


def _ask(link: http.client.HTTPConnection, query: str) -> bytes:
    link.request("GET", f"/picture?{query}")
    answer = link.getresponse()
    content = answer.read()
    if answer.status != http.client.OK:
        raise SystemExit(f"{query}: {content.decode()}")
    return content


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live", description=__doc__)
    parser.add_argument("--run", type=Path, metavar="RUN", help="a run with both methods (default: untrained weights)")
    parser.add_argument("--size", default="quick", help="of openstage, without --run (default: quick)")
    parser.add_argument("--frames", type=int, default=30, metavar="N", help="of each movement (default: 30)")
    arguments = parser.parse_args()
    portraits = untrained(arguments.size) if arguments.run is None else of_run(arguments.run)
    table = Table(box=None, header_style="dim", title=f"{SIZE[0]} x {SIZE[1]} pictures; goal {GOAL:g} a second")
    for title in ("avatar", "moves", "pictures", "a second", "ms", "slowest ms", "processor ms"):
        table.add_column(title, justify="left" if title in ("avatar", "moves", "pictures") else "right")
    for each in measured(portraits, arguments.frames):
        times = (f"{each.rate:.1f}", f"{median(each.wall_ms):.0f}", f"{max(each.wall_ms):.0f}", f"{each.used_ms:.0f}")
        table.add_row(each.avatar, each.moves, "drafts" if each.draft else "whole", *times)
    Console().print(table)


if __name__ == "__main__":
    main()
