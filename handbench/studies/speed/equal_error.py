"""How long a renderer takes to an error: read off the Pareto front of its measured points, never beyond them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from ...results.schema import told
from .measure import ErrorCurve, Trial

TARGETS = (0.10, 0.03, 0.01, 0.003)
"""Relative RMSE at which renderers are compared."""


@dataclass(frozen=True)
class Reached:
    """Seconds to an error. `bound`: the cheapest setting that was measured is better already, so it may take less."""

    seconds: float
    bound: bool = False


def pareto(points: Iterable[Trial]) -> list[Trial]:
    """The points that no other beats in both time and error, from quick and wrong to slow and right."""
    front: list[Trial] = []
    for point in sorted(points, key=lambda p: (p.time, p.error)):
        if not front or point.error < front[-1].error:
            front.append(point)
    return front


def time_at(points: Iterable[Trial], error: float) -> Reached | None:
    """Seconds to a relative error: interpolated in log time over log error along the Pareto front.

    None if no point reaches it.
    """
    front = pareto(points)
    if not front or front[-1].error > error:
        return None
    if front[0].error <= error:
        return Reached(front[0].time, bound=front[0].error < error)
    after = next(i for i, point in enumerate(front) if point.error <= error)
    before, beyond = front[after - 1], front[after]
    low = max(beyond.error, 1e-12)  # a point may be exact
    share = math.log(before.error / error) / math.log(before.error / low)
    return Reached(before.time * (beyond.time / before.time) ** share)


@dataclass(frozen=True)
class SpeedUp:
    """How many times faster ours is at an error; `sign` is "=", ">=" or "<=" where one side is only bounded.

    times is None where it cannot be said, and `reason` says why.
    """

    times: float | None
    sign: Literal["=", ">=", "<="] = "="
    reason: str = ""


def speed_up(ours: Reached | None, theirs: Reached | None) -> SpeedUp:
    """Their time over ours."""
    if ours is None:
        return SpeedUp(None, reason="not reached by handbench")
    if theirs is None:
        return SpeedUp(None, reason="not reached")
    if ours.bound and theirs.bound:
        return SpeedUp(None, reason="both coarsest settings are better")
    sign: Literal["=", ">=", "<="] = ">=" if ours.bound else "<=" if theirs.bound else "="
    return SpeedUp(theirs.seconds / ours.seconds, sign)


@dataclass(frozen=True)
class TimeAt:
    """A renderer's time to an error."""

    error: float = told("relative RMSE")
    seconds: float | None = told("null where it was not reached")
    bound: bool = told("whether the cheapest setting is better already, so it may take less", default=False)
    compared: bool = told("whether handbench's time is beside it", default=False)
    speed_up: float | None = told("how many times faster handbench is; null where that cannot be said", default=None)
    sign: Literal["=", ">=", "<="] = told("whether the ratio is only bounded", default="=")
    reason: str = told("why there is no ratio", default="")


@dataclass(frozen=True)
class RendererTimes:
    """A renderer's times to the same errors, for new poses or for known ones."""

    pose: Literal["new", "known"] = told("which poses")
    renderer: str = told("its name")
    cells: tuple[TimeAt, ...] = told("one an error")


def table(curves: Sequence[ErrorCurve], targets: Sequence[float] = TARGETS) -> tuple[RendererTimes, ...]:
    """A line a pose and renderer: seconds to each error, and for competitors how much faster ours is."""
    lines = []
    for pose in dict.fromkeys(curve.pose for curve in curves):
        of_pose = [curve for curve in curves if curve.pose == pose]
        ours = [time_at(of_pose[0].points, target) for target in targets]
        for curve in of_pose:
            cells = []
            for target, mine in zip(targets, ours, strict=True):
                found = time_at(curve.points, target)
                cell = TimeAt(target, found.seconds if found else None, bool(found and found.bound))
                if curve is not of_pose[0]:
                    ratio = speed_up(mine, found)
                    cell = replace(cell, compared=True, speed_up=ratio.times, sign=ratio.sign, reason=ratio.reason)
                cells.append(cell)
            lines.append(RendererTimes(pose, curve.renderer, tuple(cells)))
    return tuple(lines)
