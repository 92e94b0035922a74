"""A picture and its mirror image have nearly the same fits: what one finds is a start for the other.

Seen from far away, a right hand turned by half a turn about the picture's vertical looks like a left hand with the same
joint angles: that is what the mirror shows. Only depth, perspective and where a hand ends tell them apart. So a
mirror image that fits better than the picture is no left hand until the picture was tried from there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...evenly import evenly
from .picture import CloseUp
from .placed import Placed
from .single import FittingSettings, Single, again, single
from .solve import solve
from .space import Space
from .terms import Objective

_MORE = 3  # times as many starts, where a mirror image fits better


def with_mirrors(
    space: Space, views: dict[int, CloseUp], ours: dict[int, Single], settings: FittingSettings, most: int = 3
) -> tuple[dict[int, Single], dict[int, float]]:
    """The hands of pictures, better ones where the mirror image led to one, and for at most some of them, spread over
    the sequence, what the mirror image costs in the end (infinite where nothing starts)."""
    better, costs = dict(ours), dict[int, float]()
    keys = list(ours)
    for i in evenly(keys, most):
        view, own = views[i], ours[i]
        mirror = view.mirrored()
        other = single(space, mirror, settings)
        if other is None:
            costs[i] = np.inf
            continue
        if other.untold < own.untold:
            own = better[i] = _tried(space, view, own, other, settings)
        else:
            other = _tried(space, mirror, other, own, settings, more=1)
        costs[i] = other.untold
    return better, costs


def _tried(
    space: Space, view: CloseUp, own: Single, other: Single, settings: FittingSettings, more: int = _MORE
) -> Single:
    """The best of a fit, of one that begins with the mirror image's hand turned over, and of more starts."""
    found = [own]
    if view.depth is None:
        far = Objective(space, [view], settings.weights.far)
        start = solve(far, replace(other.state, hands=(turned(other.state.hands[0]),)), settings.steps)
        found.append(again(space, view, start, settings))
    if more > 1 and (fresh := single(space, view, replace(settings, starts=more * settings.starts))) is not None:
        found.append(fresh)
    return min(found, key=lambda one: one.cost)


def turned(hand: Placed) -> Placed:
    """A hand of the mirror image by half a turn about the vertical, as it is seen in the picture itself.

    The wrist stays at its distance, which is as good as any other point of the hand: a fit goes on from here.
    """
    half = np.diag([-1.0, 1.0, -1.0])
    return replace(hand, rotation=half @ hand.rotation, translation=hand.translation * np.array([-1.0, 1.0, 1.0]))
