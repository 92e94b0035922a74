"""Draws the frames of a relighting with the clock on. Frames are files, so what was drawn once is not drawn again."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import numpy as np

from .. import __version__
from ..avatars.portrait import Held, Portrait
from ..bench.isolation import isolated
from ..bench.progress import Steps
from ..bench.protocol import digest
from ..data.exr import read_exr, rgb, stack, write_exr
from ..errors import InputError, NonFinite, StorageError
from ..files import read_json, whole, writing
from ..method import Progress
from ..scene import Array, Environment, Prediction
from ..tuning import tune
from .shots import Shots, Wish

_PLAN = "frames.json"
_HALF = 65504.0
_WAITING = 4  # frames that may wait for the disk


@dataclass
class DrawingTimes:
    """Milliseconds of the frames that were drawn now: of a new pose, pose and relight together, and of a known one."""

    new_pose: list[float] = field(default_factory=list)
    known_pose: list[float] = field(default_factory=list)

    def __str__(self) -> str:
        named = (("a new pose", self.new_pose), ("a known pose", self.known_pose))
        parts = [f"{median(ms):.0f} ms for {what} ({len(ms)} frames)" for what, ms in named if ms]
        return ", ".join(parts) or "nothing drawn now"

    @property
    def told(self) -> dict[str, float | int | None]:
        """Medians in milliseconds, None where nothing was drawn, and how many frames were."""
        return {
            "new_pose_ms": median(self.new_pose) if self.new_pose else None,
            "new_pose_frames": len(self.new_pose),
            "known_pose_ms": median(self.known_pose) if self.known_pose else None,
            "known_pose_frames": len(self.known_pose),
        }


@dataclass(frozen=True)
class DrawnFrames:
    """The drawn frames of several portraits: `folder` has one EXR a frame and portrait, half floats, linear."""

    folder: Path
    count: int
    portraits: int

    def path(self, frame: int, portrait: int) -> Path:
        return self.folder / f"{frame:05d}-{portrait:02d}.exr"

    def read(self, frame: int, portrait: int) -> tuple[Array, Array]:
        """Image (H, W, 3) and alpha (H, W), float32."""
        path = self.path(frame, portrait)
        channels = read_exr(path)
        return stack(channels, ("R", "G", "B"), path), channels["A"]

    def remove(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)


def draw(
    portraits: Sequence[Portrait], wish: Wish, maps: Sequence[Environment], folder: Path, told: Steps
) -> tuple[DrawnFrames, list[DrawingTimes]]:
    """Draw what is missing of a relighting into a folder, and what that took, portrait by portrait. `maps` are those of
    the wish's lights, as they were read.

    Frames of another relighting in the folder are removed. Raises `InputError` for portraits with different numbers of
    frames, `Unsupported` for a light or pose outside a method's abilities, `NonFinite` for a picture that is none, and
    `StorageError` if the folder cannot be written.
    """
    tune()
    shots = [Shots(portrait, wish) for portrait in portraits]
    counts = [len(each) for each in shots]
    if len(set(counts)) > 1:
        several = " and ".join(str(len(each.postures)) for each in shots)
        raise InputError(f"the avatars have {several} poses; give --seconds, over which those of each are spread")
    frames = DrawnFrames(folder, counts[0], len(portraits))
    _prepare(folder, digest([__version__, wish.said(), [portrait.digest for portrait in portraits]]))
    for portrait, shown in zip(portraits, shots, strict=True):
        shown.check()
        for each in maps:
            portrait.check(each)
    times = []
    with ThreadPoolExecutor(1) as disk:
        for index, (portrait, shown) in enumerate(zip(portraits, shots, strict=True)):
            with isolated():
                times.append(_drawn(portrait, shown, index, frames, maps, disk, told(f"{portrait.name}: frames")))
    return frames, times


def _drawn(
    portrait: Portrait,
    shots: Shots,
    index: int,
    frames: DrawnFrames,
    maps: Sequence[Environment],
    disk: ThreadPoolExecutor,
    progress: Progress,
) -> DrawingTimes:
    times = DrawingTimes()
    waiting: list[Future[None]] = []
    held: Held | None = None
    last = 0  # the frame that was drawn last
    for frame in range(len(shots)):
        if not frames.path(frame, index).is_file():
            light, viewpoint = shots.light(frame, maps), shots.viewpoint(frame)
            known = held is not None and shots.same_pose(last, frame)
            start = time.perf_counter()
            held, last = portrait.posed(viewpoint, held if known else None), frame
            answer = held.posed.relight(light)
            (times.known_pose if known else times.new_pose).append(1e3 * (time.perf_counter() - start))
            waiting.append(disk.submit(_write, frames.path(frame, index), _sound(portrait, answer)))
            if len(waiting) > _WAITING:
                waiting.pop(0).result()
        progress(frame + 1, len(shots))
    for each in waiting:
        each.result()
    return times


def _sound(portrait: Portrait, answer: Prediction) -> Prediction:
    bad = int((~np.isfinite(answer.image)).sum() + (~np.isfinite(answer.alpha)).sum())
    if bad:
        raise NonFinite(f"{portrait.name} drew {bad} values that are NaN or infinite")
    return answer


def _write(path: Path, answer: Prediction) -> None:
    image, alpha = (np.clip(values, -_HALF, _HALF) for values in (answer.image, answer.alpha))
    write_exr(path, {**rgb(image), "A": alpha.astype(np.float16)})


def _prepare(folder: Path, plan: str) -> None:
    """Create the folder, or empty it of the frames of another plan. Raises `StorageError` for a folder of others."""
    kept = folder / _PLAN
    with writing(folder):
        if folder.exists() and not kept.is_file():
            raise StorageError(
                f"{folder} is there and holds no frames of a relighting; remove it, or choose another --out"
            )
        if folder.exists():
            try:
                same = read_json(kept) == {"plan": plan}
            except InputError:
                same = False
            if same:
                return
            shutil.rmtree(folder)
        folder.mkdir(parents=True)
    with whole(kept) as part:
        part.write_text(json.dumps({"plan": plan}))
