"""Conventions that a capture may have wrong, found by trying the others: what a hand covers, and how light falls on it.

Units, cameras, sides, poses and light directions are numbers that fit any convention without an error. Here the mesh is
drawn as the capture tells it and compared with masks and shading; if another convention fits clearly better, the
sentence says which.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import assert_never

import numpy as np

from ..errors import HandbenchError, Unsupported
from ..evenly import evenly
from ..hand import hand_model, hand_of
from ..render.see.posedmesh import PosedMesh
from ..render.see.raster import Raster
from ..scene import Array, Directional, Environment, Frame, Point, Topology, Uncalibrated, Unknown, leaves
from .capture import Capture, read
from .folder.capture import Folder
from .overlap import ADDED, NOT_ADDED, POOR, doubt_of_overlap, look, overlap_of

_FRAMES = 6  # that are looked at, spread over the capture
_SHADED = 0.2  # of the correlation with shading: another convention must fit so much better to be named
_MIRRORED = 0.9  # of the area of UVs
_FAR = 0.1  # of the hand's size: how far key points may be from detected ones
_NEARER = 0.6  # of that: how much nearer they must come to name another convention
_ENOUGH = 6  # key points that must be seen
# Red over blue of hands whose median red is above _BRIGHT: in the open captures 2.3 or more in linear values, mostly
# 1.3 to 2.1 in sRGB codes, whatever skin and light.
_GREY, _BRIGHT = 2.1, 0.25


@dataclass(frozen=True)
class Checked:
    """What was found: `doubts` are sentences, `overlap` the median of mask and mesh (intersection over union), None
    where there is no mask or no mesh."""

    doubts: tuple[str, ...]
    overlap: float | None


def checked(capture: Capture) -> Checked:
    """A few frames of a capture against the conventions that are confused most."""
    every = capture.frames()
    some = evenly(every, _FRAMES)
    doubts = [*_of_uvs(some), *_of_colours(capture, some), *_of_key_points(capture, some)]
    looked = () if capture.drawn_masks else [found for frame in some if (found := look(capture, frame)) is not None]
    if not looked:
        return Checked(tuple(doubts), None)
    overlap = float(np.median([overlap_of(s.mesh, s.camera, s.mask) for s in looked]))
    doubts += doubt_of_overlap(capture, looked, overlap)
    if overlap >= POOR:
        doubts += _of_light(capture, every)
    return Checked(tuple(doubts), overlap)


def _of_colours(capture: Capture, frames: Sequence[Frame]) -> Iterator[str]:
    """A doubt about pictures of whole numbers that are said to be linear."""
    if not isinstance(capture, Folder) or not capture.linear_codes:
        return
    inside = []
    for frame in frames:
        with suppress(HandbenchError):  # `troubles` tells of those
            seen = read(capture, frame)
            inside.append(seen.image[(seen.alpha if seen.alpha is not None else seen.image.max(axis=-1)) > 0.9])
    if inside and (doubt := colour_doubt(np.concatenate(inside))) is not None:
        yield doubt


def colour_doubt(linear: Array) -> str | None:
    """Whether values (N, 3) that are said to be linear are rather sRGB codes of skin; a sentence, or None."""
    if not len(linear):
        return None
    red, _, blue = np.median(linear, axis=0)
    if red > _BRIGHT and red < _GREY * blue:
        return (
            f"the hand is as bright ({red:.2f}) and as grey (red {red / max(blue, 1e-6):.2f} of blue) as sRGB codes; "
            'if these files are ordinary pictures, say colour = "srgb"'
        )
    return None


# -- where key points are ----------------------------------------------------------------------------------------------


def _of_key_points(capture: Capture, frames: Sequence[Frame]) -> Iterator[str]:
    """A doubt where a hand model's key points are far from those that were detected."""
    if capture.hand is None:
        return
    model = hand_model(capture.hand)
    tried: dict[str, Array] = {"": np.zeros((len(model.joint_names), 3))}
    if capture.hand.startswith("mano-"):
        mean = model.named_pose("mean").joints
        tried |= {ADDED: mean, NOT_ADDED: -mean}
    off: dict[str, list[float]] = {told: [] for told in tried}
    for frame in frames:
        if frame.pose is None or frame.shape is None or isinstance(frame.camera, Uncalibrated):
            return
        with suppress(HandbenchError):  # `troubles` tells of those
            seen = read(capture, frame).keypoints
            if seen is None or (seen[:, 2] > 0).sum() < _ENOUGH:
                continue
            sure = seen[:, 2] > 0
            size = float(np.linalg.norm(np.ptp(seen[sure, :2], axis=0)))
            for told, more in tried.items():
                _, points = model.posed(frame.shape, replace(frame.pose, joints=frame.pose.joints + more))
                places, _ = frame.camera.project(points[list(model.key_points)])
                away = np.linalg.norm(places - seen[:, :2], axis=1)[sure]
                off[told].append(float(np.nan_to_num(away, nan=size).mean()) / max(size, 1e-9))
    if not off[""]:
        return
    apart = {told: float(np.median(values)) for told, values in off.items()}
    best = min(apart, key=lambda told: apart[told])
    if best and apart[best] < _NEARER * apart[""]:
        yield (
            f"key points of the hand as it is told are {apart['']:.0%} of its size from those that were seen; {best} "
            f"they would be {apart[best]:.0%}"
        )
    elif apart[""] > _FAR:
        yield (
            f"key points of the hand as it is told are {apart['']:.0%} of its size from those that were seen; look at "
            "the sheet"
        )


# -- how light falls on it -------------------------------------------------------------------------------------------

_FLIPS = {
    "x turned round": (-1, 1, 1),
    "y turned round": (1, -1, 1),
    "z turned round": (1, 1, -1),
    "all three axes turned round (from the light, not to it)": (-1, -1, -1),
}


def _of_light(capture: Capture, every: Sequence[Frame]) -> Iterator[str]:
    lit = [frame for frame in every if frame.kind in ("olat", "group")]
    told: list[float] = []
    flipped: dict[str, list[float]] = {name: [] for name in _FLIPS}
    for frame in evenly(lit, _FRAMES):
        seen = look(capture, frame)
        if seen is None:
            continue
        raster = Raster(PosedMesh(seen.mesh), frame.camera, 1)
        inside = (raster.alpha > 0.5) & (seen.seen.alpha > 0.5)  # type: ignore[operator]
        normal, bright = raster.normal_map[inside], seen.seen.image[inside].mean(axis=-1)
        centre = seen.mesh.vertices.mean(axis=0)
        told.append(_explains(frame, normal, bright, centre, (1, 1, 1)))
        for name, flip in _FLIPS.items():
            flipped[name].append(_explains(frame, normal, bright, centre, flip))
    if not told:
        return
    best = max(flipped, key=lambda name: np.mean(flipped[name]))
    if np.mean(flipped[best]) > np.mean(told) + _SHADED:
        yield (
            f"shading follows the lights as they are told by {np.mean(told):.2f} (a correlation), and by "
            f"{np.mean(flipped[best]):.2f} with {best}; mend the directions"
        )


def _explains(frame: Frame, normal: Array, bright: Array, centre: Array, flip: tuple[int, ...]) -> float:
    """Correlation of what is seen with the diffuse shading of a frame's lights, their directions flipped."""
    shading = np.zeros(len(normal))
    for light in leaves(frame.light):
        match light:
            case Directional():
                shading += np.maximum(normal @ (light.direction * flip), 0) * light.irradiance.mean()
            case Point():
                away = (light.position - centre) * flip
                shading += np.maximum(normal @ away, 0) / np.linalg.norm(away) ** 3 * light.intensity.mean()
            case Environment() | Unknown():  # which come from no one direction
                pass
            case _:
                assert_never(light)
    if not len(bright) or shading.std() == 0 or bright.std() == 0:
        return 0.0
    return float(np.corrcoef(shading, bright)[0, 1])


# -- UVs -------------------------------------------------------------------------------------------------------------


def _of_uvs(frames: Sequence[Frame]) -> Iterator[str]:
    topologies = {f.mesh.topology.digest: f.mesh.topology for f in frames if f.mesh is not None}
    for topology in topologies.values():
        if topology.uvs is None:
            yield "its meshes have no UVs, so methods that work on a texture are refused; unwrap them"
        elif _upside_down(topology):
            yield (
                "V of its UVs seems to count from the top, and the origin must be at the bottom; flip V (v -> 1 - v) "
                "when exporting"
            )


def _upside_down(topology: Topology) -> bool:
    """Whether UVs are those of a known hand model turned over, or nearly all of their area is mirrored."""
    uvs, uv_faces = topology.unwrapped
    with suppress(Unsupported):
        hand, level = hand_of(topology)
        known, known_faces = hand.topology(level).unwrapped
        own, theirs = uvs[uv_faces], known[known_faces]
        if np.allclose(own, theirs, atol=1e-3):
            return False
        if np.allclose(own, theirs * [1, -1] + [0, 1], atol=1e-3):
            return True
    across, along = (uvs[uv_faces[:, k]] - uvs[uv_faces[:, 0]] for k in (1, 2))
    area = across[:, 0] * along[:, 1] - across[:, 1] * along[:, 0]
    return bool(-area[area < 0].sum() > _MIRRORED * np.abs(area).sum())
