"""Images of a capture as the bench reads them for methods and for scores, and who is to blame for an error."""

from __future__ import annotations

from ..data.capture import Capture, by_key, read
from ..errors import BadFrame, StorageError, text_of
from ..scene import Frame, Mesh, Observation
from .failure import Failure, failure
from .lending import copied


class CaptureReader:
    """Reads a capture for methods and remembers its errors: damaged data is the user's to mend, no method's failure.

    Frames are looked up by their keys, and images are copies: what a method does to either reaches nobody else.
    Raises `InputError` for a capture with two frames of one key.
    """

    def __init__(self, capture: Capture) -> None:
        self._capture = capture
        self._frames = by_key(capture.frames())
        self._error: BadFrame | None = None

    def __call__(self, frame: Frame) -> Observation:
        """The images of a frame. Raises `BadFrame`, whatever is wrong with them."""
        try:
            return copied(read(self._capture, self._frames.get(frame.key, frame)))
        except BadFrame as error:
            self._error = error
            raise

    def surface(self, frame: Frame) -> Mesh | None:
        """The mesh that geometry is scored with: the tracked one, else the true one if the capture knows it."""
        return self._capture.truth(self._frames.get(frame.key, frame)).mesh if frame.mesh is None else frame.mesh

    def caused(self, error: BaseException) -> BadFrame | None:
        """The bad frame that an error comes from, also if a method or another process wrapped it."""
        bad = self._error
        link: BaseException | None = error
        while bad is not None and link is not None:
            if link is bad or text_of(link) == text_of(bad):
                return bad
            link = link.__cause__ or link.__context__
        return None


def blame(error: BaseException, reader: CaptureReader) -> Failure:
    """What went wrong in a method, or in a frame that it read. Raises again what the disk or the user caused."""
    if isinstance(error, StorageError):
        raise error
    return failure(reader.caused(error) or error)
