"""What a method may see when it trains, enrols a subject and is asked: the one place that decides it."""

from __future__ import annotations

from collections.abc import Callable

from ..method import MethodInfo
from ..recording import PARTS, Recording
from ..scene import Frame, Observation
from .protocol import Selected


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
        frames += [frame for column in selected.scored.values() for frame in column]
    of_subject = {frame.key: frame for frame in frames if frame.subject == subject}
    return Recording(of_subject.values(), observe, PARTS if info.truth else rule.gives)
