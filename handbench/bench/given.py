"""What a method may see when it trains, enrols a subject and is asked: the one place that decides it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Literal, get_args

from ..method import MethodInfo
from ..recording import NEEDS, PARTS, Need, Recording, kinds_of, without_geometry
from ..scene import FRAME_KINDS, Frame, FrameKind, Observation, Query, Unknown
from .resolving import Selected

AS_ENROLLED = "as-enrolled"
"""Name of the light, and of the lighting, of a query that asks for the light as enrolled."""


def training(selected: Selected, observe: Callable[[Frame], Observation]) -> Recording:
    """What `Method.train` sees: the training frames as the capture has them."""
    return Recording(selected.train, observe)


def enrolment(selected: Selected, info: MethodInfo, subject: str, observe: Callable[[Frame], Observation]) -> Recording:
    """What `Prior.personalise` sees of a subject: the frames of [enrol], and of each what [enrol] gives.

    A method without a universal prior also sees the subject's training frames, if [enrol] says so; a calibration row
    with the truth in hand sees all of everything, the scored frames too. A frame that comes twice is there once.
    """
    rule = selected.protocol.enrol
    frames = list(selected.enrol)
    if not info.universal and rule.per_identity == "train":
        frames += selected.train
    if info.truth:
        scored = (frame for column in selected.scored.values() for frame in column)
        frames += [frame for frame in scored if frame.key not in selected.without_truth]
    of_subject = {frame.key: frame for frame in frames if frame.subject == subject}
    return Recording(of_subject.values(), observe, PARTS if info.truth else rule.gives)


def asked(selected: Selected, info: MethodInfo, frame: Frame) -> Query:
    """What a method is told of a frame that it draws: pose and camera, the mesh if enrolment gives meshes, the light.

    In a column that asks for the light as enrolled nothing is told of that but this. A calibration row with the truth
    in hand looks it up by the frame's name, so it is told the frame's own.
    """
    query = frame.query
    if info.truth:
        return query
    if frame.key in selected.as_enrolled:
        query = replace(query, light=Unknown(AS_ENROLLED), lighting=AS_ENROLLED)
    gives = selected.protocol.enrol.gives
    return query if gives >= {"mesh", "uv"} else without_geometry(query, gives)


def refusal(selected: Selected, info: MethodInfo, subject: str) -> str | None:
    """Why a method cannot be tried on a subject: it needs what the capture or the protocol does not give. None: it can.

    Known before anything trains, from what the method says of itself.
    """
    label, offers = selected.protocol.label, selected.offers & PARTS
    trained = info.trains_on - (selected.teaches & PARTS) - kinds_of(selected.train)
    if missing := worded(trained & PARTS):
        return f"{info.title} trains on {missing}, which the capture does not offer"
    if missing := worded(trained):
        return f"{info.title} trains on {missing}, and [train] of {label} selects none"
    seen = enrolment(selected, info, subject, _unread)
    lacking = info.needs - (offers & seen.gives) - kinds_of(seen.frames)
    if missing := worded((lacking & PARTS) - offers):
        return f"{info.title} needs {missing}, which the capture does not offer"
    if missing := worded(lacking & PARTS):
        return f"{info.title} needs {missing}, which [enrol] of {label} does not give"
    if missing := worded(lacking):
        return f"{info.title} needs {missing} of {subject}, and enrolment in {label} has none"
    return None


Enrolled = Literal[
    "single lights",
    "light groups",
    "fully lit views",
    "environments",
    "phone scan",
    "views in unknown light",
    "one picture",
    "the truth",
    "not told",
]
"""What enrolment gave, as rows of tables are labelled. Of single lights, groups, fully lit views and environments the
first that there is; a phone scan has depth under a light that is not told; pictures made elsewhere do not tell."""


def enrolled_with(selected: Selected, info: MethodInfo, subject: str | None = None) -> Enrolled:
    """What a method sees of a subject; None for the most that it sees of any."""
    if info.truth:
        return "the truth"
    if not info.timed:
        return "not told"
    subjects = selected.protocol.subjects if subject is None else (subject,)
    found = {_label(enrolment(selected, info, each, _unread), selected.offers) for each in subjects}
    return next(label for label in get_args(Enrolled) if label in found)


def _label(seen: Recording, offers: frozenset[Need]) -> Enrolled:
    if len(seen.frames) == 1:
        return "one picture"
    given = seen.gives & offers
    if "light" not in given:
        return "phone scan" if "depth" in given else "views in unknown light"
    kinds = {frame.kind for frame in seen.frames}
    return next(_OF_KIND[kind] for kind in FRAME_KINDS if kind in kinds)


_OF_KIND: dict[FrameKind, Enrolled] = {
    "olat": "single lights",
    "group": "light groups",
    "full": "fully lit views",
    "environment": "environments",
}


def _unread(frame: Frame) -> Observation:
    raise AssertionError(f"{frame.key} is only planned with")


_WORDS: dict[Need, str] = {
    "image": "pictures",
    "alpha": "masks",
    "camera": "calibrated cameras",
    "depth": "depth maps",
    "normal": "normal maps",
    "uv": "UVs",
    "keypoints": "key points",
    "scan": "scans",
    "pose": "poses",
    "shape": "hand shapes",
    "mesh": "tracked meshes",
    "light": "known light",
    "olat": "single-light frames",
    "group": "frames under groups of lights",
    "full": "fully lit frames",
    "environment": "frames under environments",
    "olat or group": "frames with few lights",
}
assert _WORDS.keys() == NEEDS


def worded(needs: Iterable[Need]) -> str:
    """Needs in words: "masks and pictures"."""
    return " and ".join(_WORDS[need] for need in sorted(needs))
