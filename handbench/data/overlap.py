"""What a hand covers, against masks: as a capture tells it, and by the conventions that are confused with its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import HandbenchError
from ..hand import hand_model
from ..hand.handmodel import HandModel
from ..render.see.posedmesh import PosedMesh
from ..render.see.raster import Raster
from ..scene import Array, Camera, Frame, Mesh, Observation, Pose, Uncalibrated
from .capture import Capture, read

POOR = 0.6
"""Overlap below which the sheet should be looked at, whatever else is tried."""
ADDED = "with poses to which the mean pose is added (flat_hand_mean = false)"
NOT_ADDED = "with poses to which the mean pose is not added (flat_hand_mean = true)"

_BETTER = 0.08  # of the overlap: another convention must fit so much better to be named
_SIZE = 96  # rows at which overlaps are measured


@dataclass(frozen=True, eq=False)
class OverlapView:
    """A frame with its mask (H, W) bool, at few pixels, and the mesh that the capture tells of."""

    frame: Frame
    seen: Observation
    mesh: Mesh
    camera: Camera
    mask: Array


def look(capture: Capture, frame: Frame) -> OverlapView | None:
    """What is compared of a frame; None for one that cannot be read, or without mask, mesh or calibration."""
    try:
        seen = read(capture, frame)
        mesh = mesh_of(capture, frame)
        if mesh is not None and not len(mesh.vertices):  # which are read here, if they are not yet
            return None
    except HandbenchError:  # `troubles` tells of those
        return None
    if mesh is None or seen.alpha is None or isinstance(frame.camera, Uncalibrated) or not (seen.alpha > 0.5).any():
        return None
    step = max(1, frame.camera.height // _SIZE)
    return OverlapView(
        frame, seen, mesh, _smaller(frame.camera, step), seen.alpha[step // 2 :: step, step // 2 :: step] > 0.5
    )


def mesh_of(capture: Capture, frame: Frame) -> Mesh | None:
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


def overlap_of(mesh: Mesh, camera: Camera, mask: Array) -> float:
    """Intersection over union of what a mesh covers and a mask (H, W) bool."""
    covered = Raster(PosedMesh(mesh), camera, 1).alpha > 0.5
    return float((covered & mask).sum() / max((covered | mask).sum(), 1))


def doubt_of_overlap(capture: Capture, looked: Sequence[OverlapView], overlap: float) -> Iterator[str]:
    """A doubt where another convention brings hand and masks clearly closer than their `overlap`, or none does."""
    if overlap + _BETTER >= 1.0:  # as nothing can be better
        return
    others = dict(_others(capture))
    tried = {}
    for told, change in others.items():
        try:
            tried[told] = float(np.median([overlap_of(*change(seen)) for seen in looked]))
        except HandbenchError:  # such a camera or such a hand cannot be
            continue
    best = max(tried, key=lambda told: tried[told], default=None)
    if best is not None and tried[best] > max(overlap + _BETTER, POOR):
        yield (
            f"the hand as it is told and the masks share {overlap:.0%} of what they cover; {best} it would be "
            f"{tried[best]:.0%}"
        )
    elif overlap < POOR:
        yield (
            f"the hand as it is told and the masks share only {overlap:.0%} of what they cover, and no convention "
            "that is known does better; look at the sheet"
        )


_Change = Callable[[OverlapView], tuple[Mesh, Camera, Array]]


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
        yield ADDED, _joints(model, mean)
        yield NOT_ADDED, _joints(model, -mean)
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
    def change(seen: OverlapView) -> tuple[Mesh, Camera, Array]:
        pose, shape = seen.frame.pose, seen.frame.shape
        if pose is None or shape is None:
            return seen.mesh, seen.camera, seen.mask
        return model.mesh(shape, replace(pose, joints=pose.joints + more), 0), seen.camera, seen.mask

    return change


def _other_side(model: HandModel) -> _Change:
    """The hand in a mirror, turned by the same rotation."""

    def change(seen: OverlapView) -> tuple[Mesh, Camera, Array]:
        pose, shape = seen.frame.pose, seen.frame.shape
        if pose is None or shape is None:
            return seen.mesh, seen.camera, seen.mask
        still = Pose(pose.joints * [1, -1, -1])
        vertices = model.mesh(shape, still, 0).vertices * [-1, 1, 1]
        turned = vertices @ Rotation.from_rotvec(pose.rotation.copy()).as_matrix().T + pose.translation
        return Mesh(turned, model.topology(0)), seen.camera, seen.mask

    return change
