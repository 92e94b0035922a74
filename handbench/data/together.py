"""Two captures as one: methods train on the people of the one and are scored on those of the other."""

from __future__ import annotations

import hashlib

from ..errors import InputError
from ..recording import Need
from ..scene import Frame, Observation
from .capture import Capture


class Together(Capture):
    """The frames of the capture that is scored, then those of the one that is trained on.

    Subjects are told apart by their names alone, so both must not have one of a name. `offers` is what the scored
    capture has, `teaches` what the other has. Raises `InputError` for a name that both have.
    """

    def __init__(self, scored: Capture, trained: Capture) -> None:
        self._parts = scored, trained
        self.name, self.hand = scored.name, scored.hand
        self.digest = hashlib.sha256(f"{scored.digest} trained on {trained.digest}".encode()).hexdigest()
        self._frames = scored.frames() + trained.frames()
        known = {frame.subject for frame in scored.frames()}
        self._taught = {frame.subject for frame in trained.frames()}
        if both := sorted(known & self._taught):
            raise InputError(
                f"{scored.name} and {trained.name} both have a subject {both[0]!r}, scored and trained on; "
                "rename one, or train on another capture"
            )

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    @property
    def offers(self) -> frozenset[Need]:
        return self._parts[0].offers

    @property
    def teaches(self) -> frozenset[Need]:
        return self._parts[1].offers

    def observe(self, frame: Frame) -> Observation:
        return self._of(frame).observe(frame)

    def truth(self, frame: Frame) -> Frame:
        return self._of(frame).truth(frame)

    def _of(self, frame: Frame) -> Capture:
        return self._parts[frame.subject in self._taught]
