"""Frames as a method sees them: those that it may see, and of each no more than is given."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import replace
from typing import Any, Literal, get_args

from .errors import InputError
from .scene import Frame, FrameKind, Observation

Part = Literal["image", "alpha", "camera", "depth", "normal", "uv", "pose", "shape", "mesh", "light"]
"""What can be given of a frame. "uv" is the UVs of meshes and the UV maps of pictures."""
PARTS: frozenset[Part] = frozenset(get_args(Part))


class Recording:
    """The frames that a method may see, and the way to their images.

    `frames` are without the parts that are not given. `observe(frame)` reads (and may cache) the images of one of
    them, again without what is not given; the arrays are read-only.
    """

    def __init__(
        self, frames: Iterable[Frame], observe: Callable[[Frame], Observation], gives: frozenset[Part] = PARTS
    ) -> None:
        recorded = tuple(frames)
        self.gives = gives
        self.frames = recorded
        self.observe = _reader(dict(zip((f.key for f in self.frames), recorded, strict=True)), observe, gives)

    @property
    def subjects(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(frame.subject for frame in self.frames))

    def where(self, keep: Callable[[Frame], bool]) -> Recording:
        """The recording of the frames for which `keep(frame)` is true."""
        part = copy(self)
        part.frames = tuple(filter(keep, self.frames))
        return part

    def of_subject(self, subject: str) -> Recording:
        return self.where(lambda frame: frame.subject == subject)

    def of_kind(self, *kinds: FrameKind) -> Recording:
        return self.where(lambda frame: frame.kind in kinds)


def _reader(
    recorded: dict[str, Frame], observe: Callable[[Frame], Observation], gives: frozenset[Part]
) -> Callable[[Frame], Observation]:
    """Reads the images of the recorded frames by their keys: whatever frame it is asked for, it tells no other."""
    withheld: dict[str, Any] = dict.fromkeys({"depth", "normal", "uv"} - gives)

    def read(frame: Frame) -> Observation:
        if frame.key not in recorded:
            raise InputError(f"frame {frame.key} is not one of this recording; observe only the frames it hands over")
        found = observe(recorded[frame.key])
        return replace(found, **withheld) if withheld else found

    return read
