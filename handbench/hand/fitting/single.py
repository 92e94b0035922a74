"""The hand of one picture by itself: the best of several starts."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .picture import CloseUp
from .solve import State, cost, solve
from .space import Space
from .starts import starts
from .terms import Objective, Placed, Weights


@dataclass(frozen=True)
class Settings:
    """How a fit is made: `level` of the surface that is compared, how many best `starts` are tried, `steps` of the
    solver at each stage, and `together`: from how many pictures of a sequence the shape is found; the others, between
    them, are posed only."""

    level: int = 1
    starts: int = 2
    steps: int = 20
    together: int = 12
    weights: Weights = field(default_factory=Weights)


QUICK = Settings()
THOROUGH = Settings(starts=5, steps=60, together=60)


@dataclass(frozen=True)
class Single:
    """A hand found in one picture, its shape by this picture alone, and what it costs."""

    state: State
    cost: float


def single(space: Space, view: CloseUp, settings: Settings, also: tuple[Placed, ...] = ()) -> Single | None:
    """The hand that the best starts lead to; `also` are tried as starts. None if nothing starts.

    Half of the steps, with a far reach, shows which start leads to the cheapest hand; it alone goes on.
    """
    far, objective = (Objective(space, [view], weights) for weights in (settings.weights.far, settings.weights))
    still = np.zeros(space.shape_basis.shape[1])
    first = max(1, settings.steps // 2)
    found = [solve(far, State(still, (start.hand,)), first) for start in starts(space, view, settings.starts, also)]
    if not found:
        return None
    best = solve(objective, min(found, key=lambda state: cost(far, state)), settings.steps - first)
    return Single(best, cost(objective, best))
