"""An avatar draws its queries with the clock on."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from statistics import median

import numpy as np

from ..errors import Unsupported
from ..evenly import evenly
from ..method import Avatar, MethodInfo, PosedAvatar, RecordedAvatar
from ..results.measured import Spread
from ..scene import Frame, Light, Prediction, Query, TimedKind, Unknown, kind_of, leaves
from .failure import Failure
from .lending import answered
from .reader import CaptureReader, blame

_REPEATS = 4  # queries of each kind of light that are drawn a second time, posed anew


class TimedRenderer:
    """Draws the queries of an avatar with the clock on; those of one viewpoint share a posed avatar.

    new_pose_ms     by kind of light, milliseconds of pose and relight together, for a viewpoint that nothing is kept of
    known_pose_ms   by kind of light, milliseconds of relight, for a viewpoint that was drawn under another light
    seconds         of everything that was drawn
    """

    def __init__(self, reader: CaptureReader, ask: Callable[[Frame], Query], info: MethodInfo, avatar: Avatar) -> None:
        self._reader, self._ask, self._info, self._avatar = reader, ask, info, avatar
        self._key = ""
        self._posed: PosedAvatar | Failure
        self.new_pose_ms: dict[TimedKind, list[float]] = {}
        self.known_pose_ms: dict[TimedKind, list[float]] = {}
        self.seconds = 0.0

    def draw(self, frame: Frame) -> Prediction | Failure:
        """A frame's picture, or why there is none. What the last frame's viewpoint keeps is used for an equal one."""
        return self._checked(frame, self._recorded if isinstance(self._avatar, RecordedAvatar) else self._shared)

    def anew(self, frame: Frame) -> Prediction | Failure:
        """A frame's picture from a new posed avatar, which is dropped."""
        return self._checked(frame, self._recorded if isinstance(self._avatar, RecordedAvatar) else self._new)

    def _recorded(self, frame: Frame) -> Prediction:
        return self._avatar.relight(self._ask(frame))

    def _new(self, frame: Frame) -> Prediction:
        asked = self._ask(frame)
        start = time.perf_counter()
        prediction = self._avatar.pose(asked.viewpoint).relight(asked.light)
        self.new_pose_ms.setdefault(timed_kind(frame, asked), []).append((time.perf_counter() - start) * 1e3)
        return prediction

    def _shared(self, frame: Frame) -> Prediction | Failure:
        asked = self._ask(frame)
        start, times = time.perf_counter(), self.known_pose_ms
        if self._key != frame.viewpoint.key:
            self._key, times = frame.viewpoint.key, self.new_pose_ms
            try:
                self._posed = self._avatar.pose(asked.viewpoint)
            except BaseException as error:  # for all lights of the viewpoint
                self._posed = blame(error, self._reader)
        if isinstance(self._posed, Failure):
            return self._posed
        prediction = self._posed.relight(asked.light)
        times.setdefault(timed_kind(frame, asked), []).append((time.perf_counter() - start) * 1e3)
        return prediction

    def _checked(self, frame: Frame, draw: Callable[[Frame], Prediction | Failure]) -> Prediction | Failure:
        start = time.perf_counter()
        try:
            if refusal := light_refusal(self._info, self._ask(frame).light):
                raise Unsupported(refusal)
            answer = draw(frame)
            self.seconds += time.perf_counter() - start
            if isinstance(answer, Failure):
                return answer
            size, wanted = answer.alpha.shape, (frame.camera.height, frame.camera.width)
            if size != wanted:
                raise Unsupported(f"the picture is {size[1]}x{size[0]}, its camera says {wanted[1]}x{wanted[0]}")
        except BaseException as error:
            return blame(error, self._reader)
        return answered(answer)


def light_refusal(info: MethodInfo, light: Light) -> str | None:
    """Why a method is not asked to draw a light: it holds a kind that the method does not declare. None: it is."""
    for single in leaves(light):
        kind = kind_of(single)
        if kind not in info.lights:
            return f"{info.title} cannot draw {kind} lights"
    return None


def timed_kind(frame: Frame, asked: Query) -> TimedKind:
    """The light that a frame is drawn under: its own kind, unless the method is not told it."""
    return "unknown" if any(isinstance(light, Unknown) for light in leaves(asked.light)) else frame.kind


def repeated(frames: Sequence[Frame], ask: Callable[[Frame], Query]) -> set[str]:
    """Keys of at most `_REPEATS` frames of each kind of light, evenly spread: they are drawn again, posed anew."""
    kinds: dict[TimedKind, list[str]] = {}
    for frame in frames:
        kinds.setdefault(timed_kind(frame, ask(frame)), []).append(frame.key)
    return {key for keys in kinds.values() for key in evenly(keys, _REPEATS)}


def same_picture(one: Prediction, other: Prediction) -> bool:
    """Equal up to the rounding of sums in another order, relative to the brightest pixel."""
    scale = max(float(np.nanmax(np.abs(one.image), initial=0.0)), 1e-6)
    return bool(np.allclose(one.image, other.image, rtol=0, atol=1e-5 * scale, equal_nan=True))


def spreads(times: dict[TimedKind, list[float]]) -> dict[TimedKind, Spread]:
    """Milliseconds of all draws by kind of light: the gate compares them one by one."""
    return {
        kind: Spread(median(ms), min(ms), max(ms), len(ms), tuple(round(value, 4) for value in ms))
        for kind, ms in times.items()
    }
