"""The study on disk, and its names: reports read it without loading what it measured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from statistics import linear_regression
from typing import Any, Literal

from ...results.origin import Provenance
from ...results.schema import told
from ..record import read_study, write_study
from .equal_error import RendererTimes
from .measure import ErrorCurve, Trial

RESULT = "speed.json"
MITSUBA = {"default": "Mitsuba direct", "tuned": "Mitsuba direct, tuned"}


@dataclass(frozen=True)
class Reference:
    """The picture that errors are measured from."""

    pixels: int = told("how many of its pixels are compared")
    noise: float = told("relative RMSE that is left in it")


@dataclass(frozen=True)
class Residual:
    """How far the converged picture of another renderer is from the reference."""

    error: float = told("relative RMSE")
    noise: float = told("how much of it is noise of that picture")


@dataclass(frozen=True)
class Learned:
    """What it took to keep a pose."""

    label: str = told("the setting")
    seconds: float = told("how long it took")


@dataclass(frozen=True)
class SceneStudy:
    """A scene drawn by every renderer at every setting."""

    name: str = told("its name")
    title: str = told("its name for readers")
    triangles: int = told("of its mesh")
    picture: tuple[int, ...] = told("width and height in pixels")
    truth: Reference = told("the reference")
    mitsuba_residual: Residual | None = told("where Mitsuba converges to; null if it was not asked")
    notes: tuple[str, ...] = told("what a reader must know")
    learn: tuple[Learned, ...] = told("what it took to keep a pose, by setting")
    curves: tuple[ErrorCurve, ...] = told("one a renderer and pose")
    equal_error: tuple[RendererTimes, ...] = told("times to the same errors")


@dataclass(frozen=True)
class Goal:
    """How many times faster than Mitsuba a picture of a scene should be at an error."""

    scene: str = told("the scene's name")
    error: float = told("relative RMSE")
    new: float = told("times, for a new pose")
    known: float = told("times, for a known pose")


@dataclass(frozen=True)
class PowerLaw:
    """time = scale * size^exponent by least squares in log-log over the last `used` sizes; error: standard error."""

    exponent: float = told("of the size")
    error: float = told("standard error of the exponent")
    scale: float = told("seconds at size 1")
    used: int = told("how many sizes it is fitted to, from the last on")


@dataclass(frozen=True)
class Scaling:
    """Time against one size."""

    axis: str = told("what grows")
    title: str = told("that for readers")
    sizes: tuple[int, ...] = told("the sizes")
    seconds: tuple[tuple[float, ...], ...] = told("of every repeat at each size")
    fit: PowerLaw = told("of the medians")


@dataclass(frozen=True)
class PoseCurve:
    """A method's settings for new poses or for known ones."""

    pose: Literal["new", "known"] = told("which")
    points: tuple[Trial, ...] = told("one a setting")


@dataclass(frozen=True)
class MethodStudy:
    """A method's error against its own full picture, and its time, by setting."""

    method: str = told("its name")
    title: str = told("its name for readers")
    curves: tuple[PoseCurve, ...] = told("of new and of known poses; none if it could not be measured", default=())
    query: str = told("the frame that was drawn", default="")
    reason: str = told("why there are no curves", default="")


@dataclass(frozen=True)
class PartTrial:
    """One setting of a part of an implicit hand; times are of one core's CPU."""

    label: str = told("the setting")
    size: float = told("what grows from setting to setting")
    error: float = told("millimetres of a distance, or relative RMSE of a picture")
    seconds: float = told("of CPU")


@dataclass(frozen=True)
class ImplicitPart:
    """A part of an implicit hand at several settings."""

    name: str = told("its name for readers")
    points: tuple[PartTrial, ...] = told("one a setting")

    @property
    def power(self) -> float | None:
        """By which power of the size the error grows, by least squares in log-log; None of a single or exact point."""
        if len(self.points) < 2 or min(point.error for point in self.points) <= 0.0:
            return None
        sizes, errors = ([math.log(getattr(p, name)) for p in self.points] for name in ("size", "error"))
        return linear_regression(sizes, errors).slope


@dataclass(frozen=True)
class Skipped:
    """A picture of an implicit hand with some skips off."""

    label: str = told("which")
    error: float = told("relative RMSE from the picture with all skips")
    seconds: float = told("of CPU")
    goal: float | None = told("how many times the time of all skips it should take at least", default=None)


@dataclass(frozen=True)
class Implicit:
    """Implicit hands: what their parts cost and how exact they are."""

    encodings: tuple[ImplicitPart, ...] = told("mean error of a learned signed distance in millimetres, by steps")
    skips: tuple[Skipped, ...] = told("all skips first, then with some off")
    directions: tuple[ImplicitPart, ...] = told("relative RMSE of light that is gathered, by directions")
    scaling: tuple[Scaling, ...] = told("how time grows")


@dataclass(frozen=True)
class SpeedRecord:
    """speed.json: error against time."""

    quick: bool = told("fewer scenes, settings and repeats")
    provenance: Provenance = told("where it comes from")
    scenes: tuple[SceneStudy, ...] = told("the scenes")
    goals: tuple[Goal, ...] = told("what is wanted")
    scaling: tuple[Scaling, ...] = told("how time grows")
    methods: tuple[MethodStudy, ...] = told("the methods")
    implicit: Implicit | None = told("implicit hands; null in studies before they were measured", default=None)


def write(folder: Path, found: SpeedRecord) -> Path:
    """`speed.json` in the folder, whole or not at all. Raises `StorageError` if it cannot be written."""
    return write_study(folder / RESULT, found)


def read(folder: Path) -> SpeedRecord:
    """What `write` wrote. Raises `InputError` where there is none, or none that this version reads."""
    return read_study(SpeedRecord, folder / RESULT, "speed", _older)


def _older(content: dict[str, Any]) -> dict[str, Any]:
    """Cells of version 1 had a ratio where another renderer was compared, and said so by nothing else."""

    def cell(old: Any) -> Any:
        return {**old, "compared": "speed_up" in old} if isinstance(old, dict) else old

    def within(name: str, change: Any, old: Any) -> Any:
        if isinstance(old, dict) and isinstance(old.get(name), list):
            return {**old, name: [change(each) for each in old[name]]}
        return old

    def scene(old: Any) -> Any:
        return within("equal_error", lambda line: within("cells", cell, line), old)

    found: dict[str, Any] = within("scenes", scene, content)
    return found
