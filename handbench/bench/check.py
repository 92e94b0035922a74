"""The laws of `handbench.method`, tried on a method with the frames of a small protocol."""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from ..data.capture import Capture
from ..errors import Changed, HandbenchError, NonFinite, Unsupported
from ..method import Avatar, Method, PosedAvatar, Prior, RecordedAvatar
from ..registry import METHODS, Entry
from ..results.laws import LINEAR, deviation, deviations, drawing
from ..scene import Frame, Observation, Prediction, Query, Viewpoint
from . import given
from .drawing import light_refusal
from .isolation import isolated
from .lending import Lender, answered
from .opening import open_data, select
from .plan import check_preset, make_method
from .progress import steps
from .protocol import Protocol
from .reader import CaptureReader, blame
from .resolving import Selected

SAME = 1e-6  # largest deviation, relative to the brightest pixel, of answers that must be the same

_Answer: TypeAlias = Prediction | HandbenchError


@dataclass(frozen=True)
class Finding:
    """Whether a law holds (None: it does not apply) and what was measured."""

    law: str
    holds: bool | None
    detail: str


def check(named: str | Entry, protocol: Protocol, preset: str | None = None, data: Path | None = None) -> list[Finding]:
    """Try every law on a method, given by name or plug-in.

    A law whose trial crashes does not hold, and its finding says why.

    Raises `InputError` for an unknown method, a protocol that does not fit its capture, and a damaged capture.
    """
    entry = METHODS.entry(named) if isinstance(named, str) else named
    check_preset((entry,), preset)
    method = make_method(entry, preset or protocol.preset_of(entry.name))
    with steps() as told:
        capture = open_data(protocol, data, told)
    return check_method(method, protocol, capture)


def check_method(method: Method, protocol: Protocol, capture: Capture) -> list[Finding]:
    """`check` for a method and a capture in hand."""
    with isolated():
        return _tried(method, protocol, select(protocol, capture), CaptureReader(capture))


def _tried(method: Method, protocol: Protocol, selected: Selected, reader: CaptureReader) -> list[Finding]:
    subjects = protocol.subjects
    refused = [why for s in subjects if (why := given.refusal(selected, method.info, s))]
    if len(refused) == len(subjects):
        return [Finding("needs", False, refused[0])]
    verdicts = [Finding("needs", None, why) for why in refused]
    try:
        trial = _Trial(method, protocol, selected, reader)
    except BaseException as error:
        return [Finding("trains and personalises", False, _reason(error, reader))]
    laws: dict[str, Callable[[], Finding]] = {
        "finite": trial.finite,
        "no mutation": trial.no_mutation,
        "no memory": trial.no_memory,
        "same seed": trial.same_seed,
        "round trip": trial.round_trip,
        "linear": trial.linear,
    }
    for law, tried in laws.items():
        try:
            verdicts.append(tried())
        except BaseException as error:
            verdicts.append(Finding(law, False, _reason(error, reader)))
    return verdicts


def _reason(error: BaseException, reader: CaptureReader) -> str:
    """Why a law does not hold. Raises `BadFrame` again: that is the user's to mend, and no law is broken."""
    if bad := reader.caused(error):
        raise bad
    return blame(error, reader).reason


class _Watched:
    """Hands out observations and knows later whether one was changed."""

    def __init__(self, reader: CaptureReader) -> None:
        self._reader = reader
        self._given: dict[str, tuple[Observation, bytes]] = {}

    def __call__(self, frame: Frame) -> Observation:
        if frame.key not in self._given:
            observation = self._reader(frame)
            self._given[frame.key] = observation, pickle.dumps(observation)
        return self._given[frame.key][0]

    def changed(self) -> list[str]:
        return [key for key, (observation, before) in self._given.items() if pickle.dumps(observation) != before]


class _Refused(Avatar):
    """Stands for a subject that a method cannot personalise to: every query is answered by the reason."""

    def __init__(self, reason: Unsupported) -> None:
        self._reason = reason

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        raise self._reason


class _Trial:
    """A trained method and its answers to the protocol's queries."""

    def __init__(self, method: Method, protocol: Protocol, selected: Selected, reader: CaptureReader) -> None:
        self.method = method
        self.protocol = protocol
        self.lender = Lender()
        self.selected = self.lender.lend(selected, method.info.name)
        self.watched = _Watched(reader)
        scored = {frame.key: frame for frames in self.selected.scored.values() for frame in frames}
        self.queries = [given.asked(self.selected, method.info, frame) for frame in scored.values()]
        self.prior = self._train()
        self.avatars = self._avatars(self.prior)
        self.answers = self._answers(self.avatars)

    def _train(self) -> Prior:
        return self.method.train(given.training(self.selected, self.watched), seed=0)

    def _avatars(self, prior: Prior) -> dict[str, Avatar]:
        avatars = {}
        for subject in self.protocol.subjects:
            enrolment = given.enrolment(self.selected, self.method.info, subject, self.watched)
            try:
                if refusal := given.refusal(self.selected, self.method.info, subject):
                    raise Unsupported(refusal)
                avatars[subject] = prior.personalise(enrolment, seed=0)
            except Unsupported as reason:  # e.g. a subject without the frames that a per-identity method trains on
                avatars[subject] = _Refused(reason)
        return avatars

    def _answers(self, avatars: dict[str, Avatar]) -> dict[str, _Answer]:
        """The answers by query: pictures, and the errors that the interface allows in their place."""
        answers: dict[str, _Answer] = {}
        for query in self.queries:
            try:
                if refusal := light_refusal(self.method.info, query.light):
                    raise Unsupported(refusal)
                answers[query.key] = answered(avatars[query.subject].relight(query))
            except (Unsupported, NonFinite) as error:
                answers[query.key] = error
        return answers

    def finite(self) -> Finding:
        pictures = _pictures(self.answers)
        bad = [key for key, a in pictures.items() if not (np.isfinite(a.image).all() and np.isfinite(a.alpha).all())]
        told = f"{len(pictures)} of {len(self.queries)} queries drawn"
        if bad:
            return Finding("finite", False, f"{told}, {len(bad)} with NaN or infinity, e.g. {bad[0]}")
        for kind, word in ((Unsupported, "unsupported"), (NonFinite, "declared non-finite")):
            if count := sum(isinstance(answer, kind) for answer in self.answers.values()):
                told += f", {count} {word}"
        return Finding("finite", bool(pictures), told)

    def no_mutation(self) -> Finding:
        repeated = self._answers(self.avatars)
        try:
            self.lender.check()
        except Changed as error:
            return Finding("no mutation", False, f"{error} was changed")
        if changed := self.watched.changed():
            return Finding("no mutation", False, f"the images of {changed[0]} were changed")
        return _equal("no mutation", "asked again", self.answers, repeated)

    def no_memory(self) -> Finding:
        """A posed avatar that draws one light after the other, against a new one for each light."""
        found: dict[str, _Answer] = {}
        for queries in self._viewpoints():
            avatar = self.avatars[queries[0].subject]
            if isinstance(avatar, RecordedAvatar):
                return Finding("no memory", None, "its pictures are recorded, it poses nothing")
            posed = avatar.pose(queries[0].viewpoint)
            for query in (*queries, queries[0]):
                found[query.key] = answered(posed.relight(query.light))
        if not found:
            return Finding("no memory", None, "no pose and camera has two lights that could be drawn")
        return _equal("no memory", "under light after light", {key: self.answers[key] for key in found}, found)

    def _viewpoints(self) -> list[list[Query]]:
        """For each subject the drawn queries of the pose and camera with most lights, if there are two or more."""
        groups: dict[str, dict[str, list[Query]]] = {}
        for query in self.queries:
            if query.key in _pictures(self.answers):
                groups.setdefault(query.subject, {}).setdefault(query.viewpoint.key, []).append(query)
        most = [max(views.values(), key=len) for views in groups.values()]
        return [queries for queries in most if len(queries) > 1]

    def same_seed(self) -> Finding:
        return _equal("same seed", "trained again", self.answers, self._answers(self._avatars(self._train())))

    def round_trip(self) -> Finding:
        with tempfile.TemporaryDirectory() as kept, tempfile.TemporaryDirectory() as avatars:
            self.prior.save(Path(kept))
            loaded = self.method.load(Path(kept))
            found = _equal("round trip", "saved and loaded", self.answers, self._answers(self._avatars(loaded)))
            if not found.holds:
                return found
            try:
                restored = {name: _restored(loaded, avatar, Path(avatars)) for name, avatar in self.avatars.items()}
            except Unsupported:  # a method need not keep avatars
                return found
            again = _equal("round trip", "avatars kept and restored", self.answers, self._answers(restored))
            return again if not again.holds else replace(found, detail=f"{found.detail}; {again.detail}")

    def linear(self) -> Finding:
        """render(a L1 + b L2) against a render(L1) + b render(L2), for neighbouring queries of one subject."""
        declared = self.method.info.linear
        if self.method.info.truth:
            return Finding("linear", None, "the truth is recorded, it has no answer to other lights")
        found = []
        asked = [query for query in self.queries if query.key in _pictures(self.answers)]
        for one, other in zip(asked, asked[1:] + asked[:1], strict=True):
            if one.subject == other.subject:
                with suppress(Unsupported, NonFinite):  # a light of two kinds, or too bright
                    found.append(deviations(drawing(self.avatars[one.subject], one), one.light, other.light))
        if not found:
            return Finding("linear", None if not declared else False, "no pair of queries could be drawn")
        worst = max(each.linearity for each in found)
        if not declared:
            return Finding("linear", None, f"not declared; largest deviation {worst:.1e}")
        return Finding("linear", worst <= LINEAR, f"largest deviation {worst:.1e}, allowed {LINEAR:.0e}")


def _restored(prior: Prior, avatar: Avatar, folder: Path) -> Avatar:
    own = Path(tempfile.mkdtemp(dir=folder))
    avatar.save(own)
    return prior.restore(own)


def _pictures(answers: dict[str, _Answer]) -> dict[str, Prediction]:
    return {key: answer for key, answer in answers.items() if isinstance(answer, Prediction)}


def _equal(law: str, what: str, before: dict[str, _Answer], after: dict[str, _Answer]) -> Finding:
    if [*map(type, before.values())] != [*map(type, after.values())]:
        return Finding(law, False, f"{what}, other queries are unsupported or non-finite")
    drawn = _pictures(after)
    pairs = [(answer, drawn[key]) for key, answer in _pictures(before).items()]
    worst = max((deviation(p.image, q.image) + deviation(p.alpha, q.alpha) for p, q in pairs), default=0.0)
    return Finding(law, worst <= SAME, f"{what}: largest deviation {worst:.1e}, allowed {SAME:.0e}")
