"""What a recording tells of a hand, as pictures to fit to."""

from __future__ import annotations

from ...errors import Unsupported
from ...recording import Recording
from ...scene import Uncalibrated, needed
from .picture import HandPicture


def pictures(recording: Recording) -> list[HandPicture]:
    """The frames of one subject in the order of time: key points, and mask, depth and estimated pose if given.

    Raises `Unsupported` without calibrated cameras or key points, and for more than one subject: their hands differ
    in shape. Raises `InputError` for key points that are not the usual 21.
    """
    if len(recording.subjects) != 1:
        names = ", ".join(recording.subjects) or "none"
        raise Unsupported(f"a hand is fitted to the frames of one subject, and these show {names}; pick one")
    found = []
    for frame in sorted(recording.frames, key=lambda frame: frame.moment or 0):
        if isinstance(frame.camera, Uncalibrated):
            raise Unsupported(f"the calibration of camera {frame.camera.name!r} is not given, and a fit needs it")
        seen = recording.observe(frame)
        points = needed(seen.keypoints, "set of key points")
        found.append(HandPicture(frame.camera, points, seen.alpha, seen.depth, frame.key, frame.pose))
    return found
