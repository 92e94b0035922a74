"""A capture: what was recorded, frame by frame, and the way to its images."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from inspect import signature
from pathlib import Path

from ..errors import BadFrame, HandbenchError, InputError, StorageError, shortened, text_of
from ..files import LONGEST_KEY
from ..method import Progress, silent
from ..recording import PARTS, Need, Part, Recording, offered
from ..registry import CAPTURES
from ..scene import Frame, Observation


def open_capture(
    name: str, size: str, folder: Path | None = None, told: Callable[[str], Progress] = lambda label: silent
) -> Capture:
    """The registered capture of a name at a size, kept in `folder` (None: the user's cache).

    What is missing of it is made; `told` gives a label its progress. Raises `InputError` for an unknown name or size,
    and for a plug-in's capture that cannot be opened or gives no frames.
    """
    entry = CAPTURES.entry(name)
    made = entry.load()
    progress = told(f"capture {name} {size}")
    if entry.target.startswith("handbench."):
        capture: Capture = made(size=size, folder=folder, progress=progress)
        return capture
    owner = f"plug-in {name!r} at {entry.target!r}"
    try:
        found = made(size=size, folder=folder, progress=progress)
        if not isinstance(found, Capture):
            raise InputError(f"{owner} makes a {type(found).__name__}, expected a handbench.Capture")
        frames = found.frames()
    except HandbenchError:
        raise
    except (Exception, SystemExit) as error:
        raise InputError(f"{owner} fails ({type(error).__name__}: {text_of(error)}); mend it") from error
    if not frames:
        raise InputError(f"{owner} has no frames at size {size!r}; check where its data are")
    if odd := next((frame for frame in frames if not isinstance(frame, Frame)), None):
        raise InputError(f"{owner} has a {type(odd).__name__} among its frames; give a handbench.Frame each")
    return found


def usual_size(name: str) -> str:
    """The size of a registered capture where none is said: its own default. Raises `InputError` for an unknown name."""
    size = signature(CAPTURES.load(name)).parameters.get("size")
    return "quick" if size is None or not isinstance(size.default, str) else size.default


class Capture(ABC):
    """Recorded frames of some subjects. Frames are light; `observe` reads images.

    `digest` identifies the content: captures of equal digest give equal pixels. `hand` names the registered hand model
    whose joints the poses turn and whose shared surface the meshes are; None if there is none. `layout` says in which
    published layout it was brought; None for one that is made here. `drawn_masks`: masks are what the told hand covers,
    and say nothing of it.
    """

    name: str
    digest: str
    hand: str | None = None
    layout: str | None = None
    drawn_masks: bool = False

    @abstractmethod
    def frames(self) -> tuple[Frame, ...]:
        """All frames in a fixed order; `Frame.key` is unique."""

    @property
    def offers(self) -> frozenset[Need]:
        """What its frames have. A capture whose pictures have depth, normal or UV maps adds them."""
        return offered(self.frames())

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is to be known of this copy of it, in sentences."""
        return ()

    @property
    def teaches(self) -> frozenset[Need]:
        """What the frames have that methods may train on; another capture's, see `Together`."""
        return self.offers

    @abstractmethod
    def observe(self, frame: Frame) -> Observation:
        """The images of a frame. Raises `InputError` if a file is missing, damaged or of the wrong size."""

    def truth(self, frame: Frame) -> Frame:
        """The frame with its true pose, shape and mesh, where the capture knows them better than its frames tell.

        For scoring: a method is told what frames say.
        """
        return frame

    def recording(self, frames: Iterable[Frame]) -> Recording:
        """The given frames as a method sees them."""
        return Recording(frames, self.observe)

    def enrolment(self, subject: str | None = None, segment: str | None = None) -> Recording:
        """The frames of one subject and, if one is named, one segment, with all that the capture tells of them.

        Raises `InputError` for a subject or a segment that is none, and for several subjects of which none is said.
        """
        every = self.frames()
        subjects = dict.fromkeys(frame.subject for frame in every)
        if subject is None and len(subjects) > 1:
            raise InputError(f"{self.name} shows {', '.join(subjects)}; say which subject is meant")
        wanted = subject or next(iter(subjects))
        frames = [f for f in every if f.subject == wanted and segment in (None, f.segment)]
        if not frames:
            kind, name = ("subject", wanted) if wanted not in subjects else ("segment", segment)
            raise InputError(f"{self.name} has no {kind} {name!r}")
        gives: frozenset[Part] = frozenset(part for part in PARTS if part in self.offers)
        return Recording(frames, self.observe, gives)


def by_key(frames: Iterable[Frame]) -> Mapping[str, Frame]:
    """Frames by their keys. Raises `InputError` for a key that comes twice, and for one that is no line of text."""
    found: dict[str, Frame] = {}
    for frame in frames:
        if not frame.key.isprintable() or len(frame.key) > LONGEST_KEY:
            raise InputError(f"the capture has a frame {shortened(frame.key)}; give names that a line can show")
        if frame.key in found:
            raise InputError(f"the capture has two frames {frame.key}; name poses, cameras and lightings apart")
        found[frame.key] = frame
    return found


def read(capture: Capture, frame: Frame) -> Observation:
    """The images of a frame, of its camera's size. Raises `BadFrame` for whatever is wrong with them."""
    try:
        seen = capture.observe(frame)
        if not isinstance(seen, Observation):
            raise InputError(f"the capture gives a {type(seen).__name__}, no Observation")
        height, width = seen.image.shape[:2]
        if (height, width) != (frame.camera.height, frame.camera.width):
            wanted = f"{frame.camera.width}x{frame.camera.height}"
            raise InputError(f"its picture is {width}x{height}, its camera says {wanted}")
    except (StorageError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        kind = "" if isinstance(error, HandbenchError) else f"{type(error).__name__}: "
        raise BadFrame(f"{frame.key}: {kind}{text_of(error)}") from error
    return seen
