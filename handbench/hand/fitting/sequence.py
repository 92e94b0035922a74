"""The hands of a sequence whose shape is known: from those that are placed to those between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ...scene import Array
from .picture import CloseUp
from .placed import Placed
from .single import FittingSettings
from .solve import State, solve, value
from .space import Space
from .starts import starts
from .terms import Objective
from .told import told_pose

_BESIDE = 3  # pictures on either side that tell what a picture usually costs
_WORSE = 1.2  # times that: the picture is tried again from its neighbours' hands


def between(
    space: Space,
    views: Mapping[int, CloseUp],
    hands: Mapping[int, Placed],
    z: Array,
    settings: FittingSettings,
    progress: Callable[[int], None],
) -> dict[int, Placed]:
    """The hands of all pictures, of which some are placed; pictures in which nothing starts are left out.

    Key points alone mislead where fingers hide each other. So the hand before is also tried as it is, and where a
    picture costs more than those around it, their hands are tried in it.
    """
    placed, started = dict(hands), len(hands)
    for i in sorted(views):
        if i not in placed and (found := _one(space, views[i], placed, i, z, settings)) is not None:
            placed[i] = found
        progress(started + len(placed))
    objectives = {i: Objective(space, [views[i]], settings.weights) for i in placed}
    costs = {i: value(objectives[i], State(z, (hand,))) for i, hand in placed.items()}
    order = sorted(placed)
    for k, i in enumerate(order):
        around = order[max(0, k - _BESIDE) : k] + order[k + 1 : k + 1 + _BESIDE]
        if not around or costs[i] < _WORSE * np.median([costs[j] for j in around]):
            continue
        beside = order[max(0, k - 1) : k] + order[k + 1 : k + 2]
        state = _cheapest(space, views[i], [placed[j] for j in beside], z, settings)
        if state is not None and (after := value(objectives[i], state)) < costs[i]:
            placed[i], costs[i] = state.hands[0], after
    return placed


def _one(
    space: Space, view: CloseUp, hands: Mapping[int, Placed], index: int, z: Array, settings: FittingSettings
) -> Placed | None:
    """The hand of a picture between others."""
    near = [hands[i] for i in sorted(hands, key=lambda i: abs(i - index))[:2]]
    if (own := told_pose(space, view)) is not None:
        near.insert(0, own)
    tried = [start.hand for start in starts(space, view, 1, tuple(near))]
    state = _cheapest(space, view, [*tried, near[0]], z, settings)
    return None if state is None else state.hands[0]


def _cheapest(
    space: Space, view: CloseUp, tried: Sequence[Placed], z: Array, settings: FittingSettings
) -> State | None:
    """Where the best of some starts leads; None if all are behind the camera."""
    far, objective = (Objective(space, [view], weights) for weights in (settings.weights.far, settings.weights))
    first = max(1, settings.steps // 3)
    states = [solve(far, State(z, (hand,)), first, shape=False) for hand in tried]
    costs = [value(far, state) for state in states]
    if not np.isfinite(min(costs)):
        return None
    return solve(objective, states[int(np.argmin(costs))], settings.steps - first, shape=False)
