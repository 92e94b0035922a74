"""The hand of one picture by itself: the best of several starts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .picture import CloseUp
from .placed import Placed
from .solve import State, solve, value
from .space import Space
from .starts import starts
from .terms import Objective, TermWeights
from .told import told_pose


@dataclass(frozen=True)
class FittingSettings:
    """How a fit is made: `level` of the surface that is compared, how many best `starts` are tried, `steps` of the
    solver at each stage, and `together`: from how many pictures of a sequence the shape is found; the others, between
    them, are posed only."""

    level: int = 1
    starts: int = 2
    steps: int = 20
    together: int = 12
    weights: TermWeights = field(default_factory=TermWeights)


QUICK = FittingSettings()
THOROUGH = FittingSettings(starts=5, steps=60, together=60)


@dataclass(frozen=True)
class Single:
    """A hand found in one picture, its shape by this picture alone, what it costs, and what without the pose that the
    picture brings (`untold`)."""

    state: State
    cost: float
    untold: float


def single(space: Space, view: CloseUp, settings: FittingSettings, also: tuple[Placed, ...] = ()) -> Single | None:
    """The hand that the best starts lead to; `also` are tried as starts. None if nothing starts.

    Half of the steps, with a far reach, shows which start leads to the cheapest hand; it alone goes on.
    """
    far = Objective(space, [view], settings.weights.far)
    still = np.zeros(space.shape_basis.shape[1])
    near = told_pose(space, view)
    also = also if near is None else (*also, near)
    first = max(1, settings.steps // 2)
    found = [solve(far, State(still, (start.hand,)), first) for start in starts(space, view, settings.starts, also)]
    if near is not None:
        found.append(solve(far, State(still, (near,)), first))  # as it is, not as key points alone would turn it
    if not found:
        return None
    return again(space, view, min(found, key=lambda state: value(far, state)), settings, settings.steps - first)


def again(space: Space, view: CloseUp, state: State, settings: FittingSettings, steps: int | None = None) -> Single:
    """The hand to which a state leads, in `steps` (all of the settings' if None)."""
    objective = Objective(space, [view], settings.weights)
    best = solve(objective, state, settings.steps if steps is None else steps)
    full, untold = (value(Objective(space, [one], settings.weights), best) for one in (view, view.untold))
    return Single(best, full, untold)
