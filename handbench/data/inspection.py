"""Every frame of a capture read once: what is wrong with it, by frame, before a run finds out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from ..errors import BadFrame, InputError, shortened
from ..evenly import evenly
from ..method import Progress, silent
from ..scene import Frame, Observation
from .capture import Capture, read

_ACROSS = 10.0  # metres: no hand
SKIN = 1.0
"""The brightest that the median of a hand is, where a white surface that faces the light is about 1."""
_FLAT = 1e-3  # of the cube of its size: the volume of a surface that is too open to have an inside


def troubles(capture: Capture, progress: Progress = silent, most: int | None = None) -> Iterator[str]:
    """One sentence for each trouble, which begins with the frame's key; nothing for a sound capture.

    Of more than `most` frames that many are read, spread over the capture.
    """
    frames = capture.frames()
    for key, count in Counter(frame.key for frame in frames).items():
        if count > 1:
            yield f"{key}: {count} frames have this key; name poses, cameras and lightings apart"
        if not key.isprintable():
            yield f"{shortened(key)}: give names that a line can show"
    if most is not None:
        frames = tuple(evenly(frames, most))
    for frame in {frame.pose_key: frame for frame in reversed(frames)}.values():
        if trouble := _of_mesh(frame):
            yield f"{frame.key}: {trouble}"
    for done, frame in enumerate(frames, start=1):
        if trouble := _of_frame(capture, frame):
            yield trouble
        progress(done, len(frames))


def _of_frame(capture: Capture, frame: Frame) -> str:
    try:
        seen = read(capture, frame)
    except BadFrame as error:
        return str(error)
    if seen.alpha is None and "alpha" in capture.offers:
        return f"{frame.key}: it has no mask, which the capture offers; add it, or leave the frame out"
    median = median_of_hand(seen)
    if median is not None and median > SKIN:
        return f"{frame.key}: the median of its hand is {median:.3g}; is it radiance of skin, or codes up to 255?"
    return ""


def median_of_hand(seen: Observation) -> float | None:
    """The median of the linear values that the mask covers; None without a mask, or with an empty one."""
    if seen.alpha is None or not (inside := seen.alpha > 0.5).any():
        return None
    return float(np.median(seen.image[inside]))


def _of_mesh(frame: Frame) -> str:
    mesh = frame.mesh
    if mesh is None:
        return ""
    try:
        vertices = mesh.vertices
    except InputError as error:  # of a mesh that is read when it is looked at
        return str(error)
    across = float(np.ptp(vertices, axis=0).max(initial=0.0))
    if across > _ACROSS:
        return f"its mesh is {across:.3g} m across; give metres, these look like millimetres"
    corners = (vertices - vertices.mean(axis=0))[mesh.topology.faces]
    volume = float(np.linalg.det(corners).sum()) / 6.0
    if volume < -_FLAT * across**3:
        return "the faces of its mesh look inwards; turn their winding round"
    return ""
