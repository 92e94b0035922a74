"""The laws of `handbench.method`, tried on a method with the frames of a small protocol."""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..data.capture import Capture
from ..errors import Unsupported
from ..method import Avatar, Method, Prior, Recording
from ..registry import CAPTURES, METHODS
from ..scene import Array, Frame, Group, Observation, Prediction, Query
from .failure import failure
from .protocol import Protocol, Selected, resolve

SAME = 1e-6  # largest deviation, relative to the brightest pixel, of answers that must be the same
LINEAR = 1e-4  # the same for the linear law: what float32 sums in another order may leave


@dataclass(frozen=True)
class Verdict:
    """Whether a law holds (None: it does not apply) and what was measured."""

    law: str
    holds: bool | None
    detail: str


def check(name: str, protocol: Protocol, preset: str | None = None, data: Path | None = None) -> list[Verdict]:
    """Try every law on a method. A law whose trial crashes does not hold, and the verdict says why.

    Raises `InputError` for an unknown method.
    """
    method = METHODS.load(name)(preset=preset or protocol.preset_of(name))
    capture = CAPTURES.load(protocol.capture)(size=protocol.size, folder=data)
    return check_method(method, protocol, capture)


def check_method(method: Method, protocol: Protocol, capture: Capture) -> list[Verdict]:
    """`check` for a method and a capture in hand."""
    try:
        trial = _Trial(method, protocol, capture)
    except Exception as error:
        return [Verdict("trains and personalises", False, failure(error).reason)]
    laws: dict[str, Callable[[], Verdict]] = {
        "finite": trial.finite,
        "no mutation": trial.no_mutation,
        "same seed": trial.same_seed,
        "round trip": trial.round_trip,
        "linear": trial.linear,
    }
    verdicts = []
    for law, tried in laws.items():
        try:
            verdicts.append(tried())
        except Exception as error:
            verdicts.append(Verdict(law, False, failure(error).reason))
    return verdicts


class _Watched:
    """Hands out observations and knows later whether one was changed."""

    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        self._given: dict[str, tuple[Observation, bytes]] = {}

    def __call__(self, frame: Frame) -> Observation:
        if frame.key not in self._given:
            observation = self._capture.observe(frame)
            self._given[frame.key] = observation, pickle.dumps(observation)
        return self._given[frame.key][0]

    def changed(self) -> list[str]:
        return [key for key, (observation, before) in self._given.items() if pickle.dumps(observation) != before]


class _Trial:
    """A trained method and its answers to the protocol's queries."""

    def __init__(self, method: Method, protocol: Protocol, capture: Capture) -> None:
        self.method = method
        self.protocol = protocol
        self.selected: Selected = resolve(protocol, capture.frames())
        self.watched = _Watched(capture)
        scored = {frame.key: frame for frames in self.selected.scored.values() for frame in frames}
        self.queries = [frame.query for frame in scored.values()]
        self.scored = tuple(scored.values())
        self.before = pickle.dumps(self.queries)
        self.prior = self._train()
        self.avatars = self._avatars(self.prior)
        self.answers = self._answers(self.avatars)

    def _train(self) -> Prior:
        return self.method.train(Recording(self.selected.train, self.watched), seed=0)

    def _avatars(self, prior: Prior) -> dict[str, Avatar]:
        avatars = {}
        for subject in self.protocol.subjects:
            frames = list(self.selected.enrol)
            frames += () if self.method.info.universal else self.selected.train
            frames += self.scored if self.method.info.truth else ()
            avatars[subject] = prior.personalise(Recording(frames, self.watched).of_subject(subject), seed=0)
        return avatars

    def _answers(self, avatars: dict[str, Avatar]) -> dict[str, Prediction]:
        """The answers by query; queries the method declares unsupported are left out."""
        answers = {}
        for query in self.queries:
            try:
                answers[query.key] = avatars[query.subject].relight(query)
            except Unsupported:
                continue
        return answers

    def finite(self) -> Verdict:
        finite = {key: np.isfinite(a.image).all() and np.isfinite(a.alpha).all() for key, a in self.answers.items()}
        bad = [key for key, good in finite.items() if not good]
        drawn = f"{len(self.answers)} of {len(self.queries)} queries drawn"
        if bad:
            return Verdict("finite", False, f"{drawn}, {len(bad)} with NaN or infinity, e.g. {bad[0]}")
        rest = "" if len(self.answers) == len(self.queries) else ", the others are declared unsupported"
        return Verdict("finite", bool(self.answers), drawn + rest)

    def no_mutation(self) -> Verdict:
        repeated = self._answers(self.avatars)
        if pickle.dumps(self.queries) != self.before:
            return Verdict("no mutation", False, "a query was changed by relight")
        if changed := self.watched.changed():
            return Verdict("no mutation", False, f"the images of {changed[0]} were changed")
        return _equal("no mutation", "asked again", self.answers, repeated)

    def same_seed(self) -> Verdict:
        return _equal("same seed", "trained again", self.answers, self._answers(self._avatars(self._train())))

    def round_trip(self) -> Verdict:
        with tempfile.TemporaryDirectory() as folder:
            self.prior.save(Path(folder))
            loaded = self.method.load(Path(folder))
            return _equal("round trip", "saved and loaded", self.answers, self._answers(self._avatars(loaded)))

    def linear(self) -> Verdict:
        """render(a L1 + b L2) against a render(L1) + b render(L2), for neighbouring queries of one subject."""
        declared = self.method.info.linear
        if self.method.info.truth:
            return Verdict("linear", None, "the truth is recorded, it has no answer to other lights")
        deviations = []
        asked = [query for query in self.queries if query.key in self.answers]
        for one, other in zip(asked, asked[1:] + asked[:1], strict=True):
            if one.subject == other.subject:
                with suppress(Unsupported):  # a light of two kinds
                    deviations.append(self._nonlinearity(one, other, 0.7, 1.9))
        if not deviations:
            return Verdict("linear", None if not declared else False, "no pair of queries could be drawn")
        worst = max(deviations)
        if not declared:
            return Verdict("linear", None, f"not declared; largest deviation {worst:.1e}")
        return Verdict("linear", worst <= LINEAR, f"largest deviation {worst:.1e}, allowed {LINEAR:.0e}")

    def _nonlinearity(self, one: Query, other: Query, a: float, b: float) -> float:
        def draw(light: Group, name: str) -> Array:
            image = self.avatars[one.subject].relight(replace(one, light=light, lighting=name)).image
            return image.astype(np.float64)

        first, second = Group((one.light,)), Group((other.light,))
        both = draw(Group((first.scaled(a), second.scaled(b))), "check-sum")
        return _deviation(both, a * draw(first, "check-first") + b * draw(second, "check-second"))


def _equal(law: str, what: str, before: dict[str, Prediction], after: dict[str, Prediction]) -> Verdict:
    if before.keys() != after.keys():
        return Verdict(law, False, f"{what}, other queries are unsupported")
    pairs = [(answer, after[key]) for key, answer in before.items()]
    worst = max((_deviation(p.image, q.image) + _deviation(p.alpha, q.alpha) for p, q in pairs), default=0.0)
    return Verdict(law, worst <= SAME, f"{what}: largest deviation {worst:.1e}, allowed {SAME:.0e}")


def _deviation(one: Array, other: Array) -> float:
    """Largest difference, relative to the brightest pixel of either; infinite if only one is finite somewhere."""
    if one.shape != other.shape or (np.isfinite(one) != np.isfinite(other)).any():
        return float("inf")
    finite = np.isfinite(one)
    if not finite.any():
        return 0.0
    scale = max(float(np.abs(one[finite]).max()), float(np.abs(other[finite]).max()), 1e-12)
    return float(np.abs(one[finite].astype(np.float64) - other[finite]).max()) / scale
