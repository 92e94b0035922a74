"""Fitting a hand model to one picture or a sequence: one shape for all, a pose and a placement for each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...evenly import evenly
from ...method import Progress, silent
from ...scene import Array, Pose
from ..handmodel import HandModel
from .doubts import Judge, distance_guessed, other_ways, shows_a_hand, unit_problem
from .mirror import with_mirrors
from .picture import CloseUp, HandPicture
from .placed import in_world
from .problems import Problem, Unfittable
from .sequence import between
from .single import QUICK, FittingSettings, Single, single
from .solve import State, solve
from .space import Space
from .terms import Objective


@dataclass(frozen=True)
class Fitted:
    """The hand of one picture, and what it leaves unexplained.

    key_points: their median distance in pixels; overlap: of the masks, intersection over union; depth: the median
    distance to the measured surface in metres; None where nothing was given. pose is in the world, None if the picture
    was left out; then the others are NaN.
    """

    picture: str
    pose: Pose | None
    key_points: float
    overlap: float | None
    depth: float | None
    problems: tuple[Problem, ...]

    @property
    def converged(self) -> bool:
        """Whether the picture shows this hand, as far as it can tell."""
        return self.pose is not None and not any(problem.fatal for problem in self.problems)


@dataclass(frozen=True)
class Fit:
    """The shape (S,) of a hand and its pose in every picture, in their order."""

    hand: HandModel
    shape: Array
    pictures: tuple[Fitted, ...]

    @property
    def problems(self) -> tuple[Problem, ...]:
        """Of all pictures; one that concerns several of them comes once."""
        return tuple(dict.fromkeys(problem for fitted in self.pictures for problem in fitted.problems))

    @property
    def converged(self) -> bool:
        """Whether a hand was found in every picture that was not left out."""
        return not self.reason

    @property
    def reason(self) -> str:
        """Why the fit is not to be used; empty if it is."""
        tried = [problem for fitted in self.pictures if fitted.pose is not None for problem in fitted.problems]
        return next((str(problem) for problem in tried if problem.fatal), "")


def fit(
    hand: HandModel, pictures: Sequence[HandPicture], settings: FittingSettings = QUICK, progress: Progress = silent
) -> Fit:
    """The hand in pictures of one person's hand, in the order in which they were taken.

    Placement and pose are found from key points by many starts, then shape, masks and depth come in (see
    `TermWeights`). From a single camera without depth a small near hand looks like a large far one: placement and size
    are good up to a scaling about the camera. Raises `Unfittable` if no picture can be used. Pictures that cannot be
    used are left out; that, and every doubt, is told in the answer's `problems`: look at `converged` before using it.
    """
    space = Space.of(hand, settings.level)
    refused = {i: problem for i, picture in enumerate(pictures) if (problem := picture.problem())}
    views = {i: CloseUp.of(picture) for i, picture in enumerate(pictures) if i not in refused}
    if not views:
        raise Unfittable(tuple(refused.values()))
    order = sorted(views)
    chosen = evenly(order, settings.together)
    if (wrong := unit_problem(space, [views[i] for i in chosen])) is not None:
        raise Unfittable((wrong,))
    total = len(chosen) + len(order)

    singles = _singles(space, {i: views[i] for i in chosen}, settings, lambda done: progress(done, total))
    if not singles:
        raise Unfittable(tuple(_nothing(picture.name) for picture in pictures))
    hands_there = {i: own for i, own in singles.items() if shows_a_hand(space, views[i], own)}
    doubts: list[Problem | None] = []
    if hands_there:
        better, mirrors = with_mirrors(space, views, hands_there, settings)
        doubts.append(other_ways(space, views, better, mirrors, settings))
        singles |= better
    state = State(
        np.mean([one.state.z for one in singles.values()], axis=0),
        tuple(one.state.hands[0] for one in singles.values()),
    )
    if len(singles) > 1:
        state = solve(Objective(space, [views[i] for i in singles], settings.weights), state, settings.steps)
    there = dict(zip(singles, state.hands, strict=True))
    hands = between(space, views, there, state.z, settings, lambda done: progress(done, total))
    doubts.append(distance_guessed([views[i] for i in hands], list(hands.values())))
    refused |= {i: _nothing(pictures[i].name) for i in order if i not in hands}

    judge = Judge(space, state.z)
    answers = []
    for i, picture in enumerate(pictures):
        if i in refused:
            answers.append(Fitted(picture.name, None, np.nan, np.nan, np.nan, (refused[i],)))
            continue
        missed, overlap, depth, problems = judge.of(views[i], hands[i])
        problems = (*(doubt for doubt in doubts if doubt is not None), *problems)
        pose = in_world(space, hands[i], picture.camera)
        answers.append(Fitted(picture.name, pose, missed, overlap, depth, problems))
    return Fit(hand, space.shape(state.z), tuple(answers))


def _singles(
    space: Space, views: Mapping[int, CloseUp], settings: FittingSettings, progress: Callable[[int], None]
) -> dict[int, Single]:
    """The hand of every picture by itself; that of the picture before is a start, since a hand moves little."""
    found: dict[int, Single] = {}
    for count, (i, view) in enumerate(views.items(), start=1):
        also = tuple(one.state.hands[0] for one in list(found.values())[-1:])
        if (own := single(space, view, settings, also)) is not None:
            found[i] = own
        progress(count)
    return found


def _nothing(picture: str) -> Problem:
    return Problem("no hand", picture, "no hand in front of the camera looks like the key points; check them and K")
