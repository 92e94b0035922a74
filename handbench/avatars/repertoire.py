"""What an avatar can be shown in: the poses and cameras of a recording, and poses from elsewhere."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError, Unsupported, unknown_name
from ..evenly import evenly
from ..hand import hand_model
from ..scene import Array, Camera, Mesh, Pose, Query, Uncalibrated, Viewpoint

MOST = 240
"""Poses that are kept of a recording, spread evenly over it: a mesh of each is part of the avatar."""


@dataclass(frozen=True, eq=False)
class Posture:
    """A pose as it is asked for: the hand model's, the tracked mesh, or both."""

    name: str
    pose: Pose | None
    mesh: Mesh | None


@dataclass(frozen=True, eq=False)
class Body:
    """The subject in the capture's hand model: shape (S,), and the level of its meshes; None for methods that bring
    their own mesh."""

    hand: str
    shape: Array
    level: int | None

    def posture(self, name: str, pose: Pose) -> Posture:
        """The subject in a pose of the hand model. Raises `Unsupported` for the pose of another hand."""
        model = hand_model(self.hand)
        if len(pose.joints) != len(model.joint_names):
            raise Unsupported(
                f"pose {name} has {len(pose.joints)} joints, and {model.name} has {len(model.joint_names)}; "
                "give poses of that hand model"
            )
        return Posture(name, pose, None if self.level is None else model.mesh(self.shape, pose, self.level))


@dataclass(frozen=True, eq=False)
class Repertoire:
    """Postures and cameras by name, in the order of the recording; `views` are pairs of them that were recorded.

    `body` poses the subject anew where the hand model is known.
    """

    subject: str
    postures: Mapping[str, Posture]
    cameras: Mapping[str, Camera]
    views: tuple[tuple[str, str], ...]
    body: Body | None = None

    @classmethod
    def of(cls, queries: Iterable[Query], body: Body | None, found: Mapping[str, Pose]) -> Repertoire:
        """That of recorded queries, without calibrated cameras left out; `found` are poses that personalisation found,
        by the pose's key ("subject/pose"), for those that are not told.

        Raises `InputError` if no view is left: a hand without a pose cannot be shown.
        """
        queries = [query for query in queries if not isinstance(query.camera, Uncalibrated)]
        postures: dict[str, Posture] = {}
        cameras: dict[str, Camera] = {}
        views: dict[tuple[str, str], None] = {}
        for query in queries:
            pose = query.pose if query.pose is not None else found.get(query.pose_key)
            if pose is None and query.mesh is None:
                continue
            postures.setdefault(query.pose_name, Posture(query.pose_name, pose, query.mesh))
            name = query.camera.name
            if name in cameras and not same_camera(cameras[name], query.camera):
                name = f"{name}@{query.pose_name}"
            cameras.setdefault(name, query.camera)
            views[query.pose_name, name] = None
        if not views:
            raise InputError("no pose of the hand is told or was found before a calibrated camera; give poses")
        kept = set(evenly(list(postures), MOST))
        chosen = tuple(view for view in views if view[0] in kept)
        seen = {camera for _, camera in chosen}
        return cls(
            queries[0].subject,
            {name: posture for name, posture in postures.items() if name in kept},
            {name: camera for name, camera in cameras.items() if name in seen},
            chosen,
            body,
        )

    def posture(self, name: str) -> Posture:
        if name not in self.postures:
            raise unknown_name("pose", name, self.postures)
        return self.postures[name]

    def camera(self, name: str) -> Camera:
        if name not in self.cameras:
            raise unknown_name("camera", name, self.cameras)
        return self.cameras[name]

    def camera_of(self, posture: str) -> Camera:
        """A camera that recorded a posture; the first there is for postures from elsewhere."""
        return self.cameras[next((camera for name, camera in self.views if name == posture), self.views[0][1])]

    def posed(self, name: str, pose: Pose) -> Posture:
        """A posture of another pose. Raises `Unsupported` where the subject's hand model is not known."""
        if self.body is None:
            raise Unsupported(
                f"the hand model and shape of {self.subject} are not told, so only recorded poses can be shown"
            )
        return self.body.posture(name, pose)

    def viewpoint(self, posture: Posture, camera: Camera) -> Viewpoint:
        return Viewpoint(self.subject, posture.name, posture.pose, posture.mesh, camera)

    def middle(self, posture: Posture) -> Array:
        """About the middle of the hand in the world, (3,): what a camera turns around."""
        if posture.mesh is not None:
            return posture.mesh.vertices.mean(axis=0)
        assert posture.pose is not None
        if self.body is None or len(hand_model(self.body.hand).joint_names) != len(posture.pose.joints):
            return posture.pose.translation
        return hand_model(self.body.hand).mesh(self.body.shape, posture.pose, 0).vertices.mean(axis=0)


def same_camera(one: Camera, other: Camera) -> bool:
    """Whether two cameras see the same."""
    size = (one.width, one.height) == (other.width, other.height)
    return size and np.array_equal(one.K, other.K) and np.array_equal(one.world_to_camera, other.world_to_camera)


def orbited(camera: Camera, middle: Array, yaw: float, pitch: float, zoom: float = 1.0) -> Camera:
    """A camera that went around a point (3,): `yaw` about +y and `pitch` upwards in degrees, `zoom` enlarges.

    From 90 degrees up it would look at the hand upside down, so its height is kept below 85.
    """
    away = camera.centre - middle
    rise = np.degrees(np.arcsin(np.clip(away[1] / np.linalg.norm(away), -1.0, 1.0)))
    pitch = float(np.clip(rise + pitch, -85.0, 85.0) - rise) if pitch else 0.0
    across = np.cross([0.0, 1.0, 0.0], away)
    length = np.linalg.norm(across)
    axis = across / length if length > 1e-9 else camera.rotation[0]
    turn = _about(np.array([0.0, 1.0, 0.0]), np.radians(yaw)) @ _about(axis, -np.radians(pitch))
    rotation = camera.rotation @ turn.T
    centre = middle + turn @ away
    K = camera.K.copy()
    K[:2, :2] *= zoom
    return replace(camera, K=K, world_to_camera=np.column_stack([rotation, -rotation @ centre]))


def resized(camera: Camera, width: int, height: int) -> Camera:
    """A camera with a picture of another size that shows all that it showed, in the middle."""
    scale = min(width / camera.width, height / camera.height)
    K = camera.K.copy()
    K[:2] *= scale
    K[:2, 2] += 0.5 * (np.array([width, height]) - scale * np.array([camera.width, camera.height]))
    return replace(camera, width=width, height=height, K=K)


def _about(axis: Array, angle: float) -> Array:
    """The rotation (3, 3) by an angle in radians about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
