"""Conventions that a capture may have wrong, found by trying the others: what a hand covers, and how light falls on it.

Units, cameras, sides, poses and light directions are numbers that fit any convention without an error. Here the mesh is
drawn as the capture tells it and compared with masks and shading; if another convention fits clearly better, the
sentence says which.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import HandbenchError, Unsupported
from ..hand import hand_model, hand_of
from ..hand.handmodel import HandModel
from ..render.see.posedmesh import PosedMesh
from ..render.see.raster import Raster
from ..scene import Array, Camera, Directional, Frame, Mesh, Observation, Point, Pose, Topology, Uncalibrated, leaves
from .capture import Capture
from .folder.capture import Folder

_FRAMES = 6  # that are looked at, spread over the capture
_BETTER = 0.08  # of the overlap: another convention must fit so much better to be named
_POOR = 0.6  # overlap below which the sheet should be looked at, whatever else is tried
_SHADED = 0.2  # of the correlation with shading, as _BETTER
_MIRRORED = 0.9  # of the area of UVs
_FAR = 0.1  # of the hand's size: how far key points may be from detected ones
_NEARER = 0.6  # of that: how much nearer they must come to name another convention
_ENOUGH = 6  # key points that must be seen
_ADDED = "with poses to which the mean pose is added (flat_hand_mean = false)"
_NOT_ADDED = "with poses to which the mean pose is not added (flat_hand_mean = true)"
_SIZE = 96  # rows at which overlaps are measured
# Red over blue of hands whose median red is above _BRIGHT: in the open captures 2.3 or more in linear values, mostly
# 1.3 to 2.1 in sRGB codes, whatever skin and light.
_GREY, _BRIGHT = 2.1, 0.25


@dataclass(frozen=True, eq=False)
class _Seen:
    """A frame with its mask (H, W) bool, at few pixels, and the mesh that the capture tells of."""

    frame: Frame
    seen: Observation
    mesh: Mesh
    camera: Camera
    mask: Array


@dataclass(frozen=True)
class Checked:
    """What was found: `doubts` are sentences, `overlap` the median of mask and mesh (intersection over union), None
    where there is no mask or no mesh."""

    doubts: tuple[str, ...]
    overlap: float | None


def checked(capture: Capture, frames: Sequence[Frame] | None = None) -> Checked:
    """A few frames of a capture against the conventions that are confused most."""
    every = capture.frames() if frames is None else frames
    some = [every[round(i)] for i in np.linspace(0, len(every) - 1, min(_FRAMES, len(every)))]
    looked = [found for frame in some if (found := _look(capture, frame)) is not None]
    doubts = [*_of_uvs(some), *_of_colours(capture, some), *_of_key_points(capture, some)]
    if not looked or capture.drawn_masks:
        return Checked(tuple(doubts), None)
    overlap = float(np.median([_overlap(s.mesh, s.camera, s.mask) for s in looked]))
    doubts += _of_overlap(capture, looked, overlap)
    if overlap >= _POOR:
        doubts += _of_light(capture, every)
    return Checked(tuple(doubts), overlap)


def _of_colours(capture: Capture, frames: Sequence[Frame]) -> Iterator[str]:
    """A doubt about pictures of whole numbers that are said to be linear."""
    if not isinstance(capture, Folder) or not capture.linear_codes:
        return
    inside = []
    for frame in frames:
        with suppress(HandbenchError):  # `troubles` tells of those
            seen = capture.observe(frame)
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
        tried |= {_ADDED: mean, _NOT_ADDED: -mean}
    off: dict[str, list[float]] = {told: [] for told in tried}
    for frame in frames:
        if frame.pose is None or frame.shape is None or isinstance(frame.camera, Uncalibrated):
            return
        with suppress(HandbenchError):  # `troubles` tells of those
            seen = capture.observe(frame).keypoints
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


# -- what the mesh covers --------------------------------------------------------------------------------------------


def _look(capture: Capture, frame: Frame) -> _Seen | None:
    try:
        seen = capture.observe(frame)
        mesh = _mesh(capture, frame)
        if mesh is not None and not len(mesh.vertices):  # which are read here, if they are not yet
            return None
    except HandbenchError:  # `troubles` tells of those
        return None
    if mesh is None or seen.alpha is None or isinstance(frame.camera, Uncalibrated) or not (seen.alpha > 0.5).any():
        return None
    step = max(1, frame.camera.height // _SIZE)
    return _Seen(
        frame, seen, mesh, _smaller(frame.camera, step), seen.alpha[step // 2 :: step, step // 2 :: step] > 0.5
    )


def _mesh(capture: Capture, frame: Frame) -> Mesh | None:
    """The mesh of a frame: tracked, or that of the hand model in its pose."""
    if frame.mesh is not None:
        return frame.mesh
    if capture.hand is None or frame.pose is None or frame.shape is None:
        return None
    return hand_model(capture.hand).mesh(frame.shape, frame.pose, 0)


def _smaller(camera: Camera, step: int) -> Camera:
    """A camera of every step-th pixel, from the one in the middle of the first."""
    height = len(range(step // 2, camera.height, step))
    width = len(range(step // 2, camera.width, step))
    K = camera.K.copy()
    K[:2] /= step
    K[:2, 2] += 0.5 - (step // 2 + 0.5) / step
    return Camera(camera.name, width, height, K, camera.world_to_camera)


def _overlap(mesh: Mesh, camera: Camera, mask: Array) -> float:
    covered = Raster(PosedMesh(mesh), camera, 1).alpha > 0.5
    return float((covered & mask).sum() / max((covered | mask).sum(), 1))


def _of_overlap(capture: Capture, looked: Sequence[_Seen], overlap: float) -> Iterator[str]:
    others = dict(_others(capture))
    tried = {}
    for told, change in others.items():
        try:
            tried[told] = float(np.median([_overlap(*change(seen)) for seen in looked]))
        except HandbenchError:  # such a camera or such a hand cannot be
            continue
    best = max(tried, key=lambda told: tried[told], default=None)
    if best is not None and tried[best] > max(overlap + _BETTER, _POOR):
        yield (
            f"the hand as it is told and the masks share {overlap:.0%} of what they cover; {best} it would be "
            f"{tried[best]:.0%}"
        )
    elif overlap < _POOR:
        yield (
            f"the hand as it is told and the masks share only {overlap:.0%} of what they cover, and no convention "
            "that is known does better; look at the sheet"
        )


_Change = Callable[[_Seen], tuple[Mesh, Camera, Array]]


def _others(capture: Capture) -> Iterator[tuple[str, _Change]]:
    """Other conventions, each with what it changes."""
    for factor, told in ((0.001, "in millimetres, not metres,"), (0.01, "in centimetres, not metres,")):
        yield f"were it {told}", _vertices(lambda v, factor=factor: v * factor)  # type: ignore[misc]
    yield "were its cameras in millimetres, not metres,", _placed(lambda m: np.c_[m[:, :3], 0.001 * m[:, 3]])
    yield "were it in metres, not millimetres,", _vertices(lambda v: v * 1000.0)
    yield (
        "with y and z of its cameras turned round (OpenGL's axes for OpenCV's)",
        _placed(lambda m: m * [[1.0], [-1], [-1]]),
    )
    yield "with cameras from camera to world, not world to camera,", _placed(_inverse)
    yield "with masks upside down", lambda s: (s.mesh, s.camera, s.mask[::-1])
    yield "with masks from right to left", lambda s: (s.mesh, s.camera, s.mask[:, ::-1])
    if capture.hand is not None and capture.hand.startswith("mano-"):
        model = hand_model(capture.hand)
        mean = model.named_pose("mean").joints
        yield _ADDED, _joints(model, mean)
        yield _NOT_ADDED, _joints(model, -mean)
        yield f"as the other hand (not {capture.hand})", _other_side(model)


def _vertices(change: Callable[[Array], Array]) -> _Change:
    return lambda s: (Mesh(change(s.mesh.vertices), s.mesh.topology), s.camera, s.mask)


def _placed(change: Callable[[Array], Array]) -> _Change:
    return lambda s: (s.mesh, _at(s.camera, change(s.camera.world_to_camera)), s.mask)


def _at(camera: Camera, world_to_camera: Array) -> Camera:
    return Camera(camera.name, camera.width, camera.height, camera.K, world_to_camera)


def _inverse(placed: Array) -> Array:
    return np.c_[placed[:, :3].T, -placed[:, :3].T @ placed[:, 3]]


def _joints(model: HandModel, more: Array) -> _Change:
    def change(seen: _Seen) -> tuple[Mesh, Camera, Array]:
        pose, shape = seen.frame.pose, seen.frame.shape
        if pose is None or shape is None:
            return seen.mesh, seen.camera, seen.mask
        return model.mesh(shape, replace(pose, joints=pose.joints + more), 0), seen.camera, seen.mask

    return change


def _other_side(model: HandModel) -> _Change:
    """The hand in a mirror, turned by the same rotation."""

    def change(seen: _Seen) -> tuple[Mesh, Camera, Array]:
        pose, shape = seen.frame.pose, seen.frame.shape
        if pose is None or shape is None:
            return seen.mesh, seen.camera, seen.mask
        still = Pose(pose.joints * [1, -1, -1])
        vertices = model.mesh(shape, still, 0).vertices * [-1, 1, 1]
        turned = vertices @ Rotation.from_rotvec(pose.rotation.copy()).as_matrix().T + pose.translation
        return Mesh(turned, model.topology(0)), seen.camera, seen.mask

    return change


# -- how light falls on it -------------------------------------------------------------------------------------------

_FLIPS = {
    "x turned round": (-1, 1, 1),
    "y turned round": (1, -1, 1),
    "z turned round": (1, 1, -1),
    "all three axes turned round (from the light, not to it)": (-1, -1, -1),
}


def _of_light(capture: Capture, every: Sequence[Frame]) -> Iterator[str]:
    lit = [frame for frame in every if frame.kind in ("olat", "group")]
    some = [lit[round(i)] for i in np.linspace(0, len(lit) - 1, min(_FRAMES, len(lit)))] if lit else []
    told: list[float] = []
    flipped: dict[str, list[float]] = {name: [] for name in _FLIPS}
    for frame in some:
        seen = _look(capture, frame)
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
        if isinstance(light, Directional):
            shading += np.maximum(normal @ (light.direction * flip), 0) * light.irradiance.mean()
        elif isinstance(light, Point):
            away = (light.position - centre) * flip
            shading += np.maximum(normal @ away, 0) / np.linalg.norm(away) ** 3 * light.intensity.mean()
    if shading.std() == 0 or bright.std() == 0:
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
