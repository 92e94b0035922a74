"""Fitting a hand model to one picture or a sequence: one shape for all, a pose and a placement for each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ...method import Progress, silent
from ...scene import Array, Camera, Pose
from ..handmodel import HandModel
from .doubts import Judge, other_ways, unit_problem
from .picture import CloseUp, Picture
from .problems import Problem, Unfittable
from .rig import rodrigues
from .single import QUICK, Settings, Single, single
from .solve import State, cost, solve
from .space import Space
from .starts import starts
from .terms import Objective, Placed


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


def fit(hand: HandModel, pictures: Sequence[Picture], settings: Settings = QUICK, progress: Progress = silent) -> Fit:
    """The hand in pictures of one person's hand, in the order in which they were taken.

    Placement and pose are found from key points by many starts, then shape, masks and depth come in (see `Weights`).
    From a single camera without depth a small near hand looks like a large far one: placement and size are good up to a
    scaling about the camera. Raises `Unfittable` if no picture can be used. Pictures that cannot be used are left out;
    that, and every doubt, is told in the answer's `problems`: look at `converged` before using it.
    """
    space = Space.of(hand, settings.level)
    refused = {i: problem for i, picture in enumerate(pictures) if (problem := picture.problem())}
    views = {i: CloseUp.of(picture) for i, picture in enumerate(pictures) if i not in refused}
    if not views:
        raise Unfittable(tuple(refused.values()))
    order = sorted(views)
    chosen = [order[k] for k in np.unique(np.linspace(0, len(order) - 1, settings.together).round().astype(int))]
    if (wrong := unit_problem(space, [views[i] for i in chosen])) is not None:
        raise Unfittable((wrong,))

    singles: dict[int, Single] = {}
    for count, i in enumerate(chosen, start=1):
        also = [one.state.hands[0] for one in list(singles.values())[-1:]]  # a hand moves little between pictures
        if (start := pictures[i].start) is not None:
            also.append(in_camera(space, start, pictures[i].camera))
        if (found := single(space, views[i], settings, tuple(also))) is not None:
            singles[i] = found
        progress(count, len(chosen) + len(order))
    if not singles:
        raise Unfittable(tuple(_nothing(picture.name) for picture in pictures))
    chosen = list(singles)
    state = State(
        np.mean([one.state.z for one in singles.values()], axis=0),
        tuple(one.state.hands[0] for one in singles.values()),
    )
    if len(chosen) > 1:
        state = solve(Objective(space, [views[i] for i in chosen], settings.weights), state, settings.steps)
    hands = dict(zip(chosen, state.hands, strict=True))
    for i in order:
        if i not in hands:
            placed = _between(space, views[i], hands, i, state.z, settings)
            if placed is None:
                refused[i] = _nothing(pictures[i].name)
            else:
                hands[i] = placed
        progress(len(chosen) + len(hands), len(chosen) + len(order))

    judge = Judge(space, state.z)
    judged = {i: judge.of(views[i], placed) for i, placed in hands.items()}
    doubt = None
    if any("no hand" not in {problem.kind for problem in found[-1]} for found in judged.values()):
        doubt = other_ways(space, [views[i] for i in chosen], list(singles.values()), settings)
    answers = []
    for i, picture in enumerate(pictures):
        if i in refused:
            answers.append(Fitted(picture.name, None, np.nan, np.nan, np.nan, (refused[i],)))
            continue
        missed, overlap, depth, problems = judged[i]
        problems = problems if doubt is None else (doubt, *problems)
        answers.append(
            Fitted(picture.name, in_world(space, hands[i], picture.camera), missed, overlap, depth, problems)
        )
    return Fit(hand, space.shape(state.z), tuple(answers))


def _between(
    space: Space, view: CloseUp, hands: dict[int, Placed], index: int, z: Array, settings: Settings
) -> Placed | None:
    """The hand of a picture between others; its shape is known. None if nothing starts.

    Key points alone mislead where fingers hide each other, so the hand before is also tried as it is.
    """
    near = [hands[i] for i in sorted(hands, key=lambda i: abs(i - index))[:2]]
    far, objective = (Objective(space, [view], weights) for weights in (settings.weights.far, settings.weights))
    tried = [start.hand for start in starts(space, view, 1, tuple(near))]
    first = max(1, settings.steps // 3)
    states = [solve(far, State(z, (hand,)), first, shape=False) for hand in (*tried, near[0])]
    costs = [cost(far, state) for state in states]
    if not np.isfinite(min(costs)):
        return None
    best = states[int(np.argmin(costs))]
    return solve(objective, best, settings.steps - first, shape=False).hands[0]


def _nothing(picture: str) -> Problem:
    return Problem("no hand", picture, "no hand in front of the camera looks like the key points; check them and K")


def in_world(space: Space, hand: Placed, camera: Camera) -> Pose:
    """The pose of a hand in the world, joints within their limits."""
    turn = Rotation.from_matrix(camera.rotation.T @ hand.rotation).as_rotvec()
    angles = np.clip(hand.angles, space.least, space.most)
    return Pose(space.turns(angles), turn, camera.rotation.T @ (hand.translation - camera.world_to_camera[:, 3]))


def in_camera(space: Space, pose: Pose, camera: Camera) -> Placed:
    """A pose in the world as a camera sees it."""
    turn = camera.rotation @ rodrigues(pose.rotation)[0]
    angles = np.clip(pose.joints.ravel()[space.free], space.least, space.most)
    return Placed(angles, turn, camera.rotation @ pose.translation + camera.world_to_camera[:, 3])
