"""A capture: what was recorded, frame by frame, and the way to its images."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from pathlib import Path

from ..method import Progress, silent
from ..recording import Recording
from ..registry import CAPTURES
from ..scene import Frame, Observation


def open_capture(
    name: str, size: str, folder: Path | None = None, told: Callable[[str], Progress] = lambda label: silent
) -> Capture:
    """The registered capture of a name at a size, kept in `folder` (None: the user's cache).

    What is missing of it is made; `told` gives a label its progress. Raises `InputError` for an unknown name or size.
    """
    return CAPTURES.load(name)(size=size, folder=folder, progress=told(f"capture {name} {size}"))


class Capture(ABC):
    """Recorded frames of some subjects. Frames are light; `observe` reads images.

    `digest` identifies the content: captures of equal digest give equal pixels. `hand` names the registered hand model
    whose joints the poses turn and whose shared surface the meshes are; None if there is none.
    """

    name: str
    digest: str
    hand: str | None = None

    @abstractmethod
    def frames(self) -> tuple[Frame, ...]:
        """All frames in a fixed order; `Frame.key` is unique."""

    @abstractmethod
    def observe(self, frame: Frame) -> Observation:
        """The images of a frame. Raises `InputError` if a file is missing, damaged or of the wrong size."""

    def recording(self, frames: Iterable[Frame]) -> Recording:
        """The given frames as a method sees them."""
        return Recording(frames, self.observe)
