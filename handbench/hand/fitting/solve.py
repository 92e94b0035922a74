"""Levenberg–Marquardt for hands in pictures: one shape for all of them, a pose and a placement for each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...scene import Array
from .placed import Placed
from .quadratic import Quadratic
from .terms import Objective

DAMPING = 1e-2  # to begin with: a little towards steepest descent


@dataclass(frozen=True)
class State:
    """All unknowns: coordinates z (K,) of the shape, and each picture's hand."""

    z: Array
    hands: tuple[Placed, ...]


def cost(objective: Objective, state: State) -> float:
    """What all terms of a state add up to."""
    rest = objective.space.rest(state.z)
    return _total(
        objective, state, [objective.of(*pair, rest) for pair in zip(objective.views, state.hands, strict=True)]
    )


def value(objective: Objective, state: State) -> float:
    """The same with masks compared pixel by pixel: what tells better hands from worse ones, wherever they started."""
    flat = Objective(objective.space, objective.views, replace(objective.weights, mask=0.0))
    rest = objective.space.still(state.z)
    pairs = zip(objective.views, state.hands, strict=True)
    return cost(flat, state) + sum(objective.area(view, hand, rest) for view, hand in pairs)


def solve(objective: Objective, state: State, steps: int, shape: bool = True, tolerance: float = 1e-3) -> State:
    """The state after at most some steps downhill, each of which lowers the cost; `shape` lets the shape move."""
    space, damping, still = objective.space, DAMPING, 0
    rest = space.rest(state.z)
    models = [objective.of(view, hand, rest) for view, hand in zip(objective.views, state.hands, strict=True)]
    height = _total(objective, state, models)
    for _ in range(steps):
        dz, moves = _step(objective, state, models, damping, shape)
        tried = State(state.z + dz, tuple(hand.moved(move) for hand, move in zip(state.hands, moves, strict=True)))
        moved = space.rest(tried.z) if shape else rest
        found = [objective.of(view, hand, moved) for view, hand in zip(objective.views, tried.hands, strict=True)]
        after = _total(objective, tried, found)
        if after < height:
            still = still + 1 if height - after < tolerance * height else 0
            state, rest, models, height, damping = tried, moved, found, after, max(damping / 4, 1e-6)
        else:
            damping *= 6
        if still == 2 or damping > 1e3:
            break
    return state


def _step(
    objective: Objective, state: State, models: Sequence[Quadratic], damping: float, shape: bool
) -> tuple[Array, list[Array]]:
    """The step of the shape (K,) and of each hand (6 + F,): the hands are eliminated first (Schur)."""
    space = objective.space
    size = 6 + len(space.free)
    count = space.shape_basis.shape[1]
    pull = 2 * objective.weights.shape
    top, right = pull * np.eye(count), -pull * state.z
    inner = []
    for model in models:
        hessian, gradient = model.hessian.copy(), model.gradient.copy()
        diagonal = np.diagonal(hessian).copy()
        hessian[np.arange(len(diagonal)), np.arange(len(diagonal))] += damping * diagonal + 1e-9
        own = np.linalg.solve(hessian[:size, :size], np.c_[-gradient[:size], hessian[:size, size:]])
        inner.append(own)
        top = top + hessian[size:, size:] - hessian[size:, :size] @ own[:, 1:]
        right = right - gradient[size:] - hessian[size:, :size] @ own[:, 0]
    dz = np.linalg.solve(top, right) if shape and count else np.zeros(count)
    return dz, [own[:, 0] - own[:, 1:] @ dz for own in inner]


def _total(objective: Objective, state: State, models: Sequence[Quadratic]) -> float:
    return sum(model.cost for model in models) + objective.weights.shape * float(state.z @ state.z)
