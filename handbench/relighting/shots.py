"""What a relighting shows, frame by frame: a pose, a camera and a light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ..avatars.portrait import Portrait
from ..avatars.repertoire import Posture, orbited, resized
from ..data.lights import NamedLight
from ..errors import InputError
from ..light.environment import rotate
from ..scene import Array, Camera, Environment, Pose, Viewpoint

MOST_FRAMES = 20_000
_HAND, _AT_LENS = 0.1, 0.02  # metres: a hand across; how near it is to no lens
_DOT = 0.02  # of a picture's longer side: what is smaller is no hand that somebody wants to see


@dataclass(frozen=True)
class Wish:
    """What is asked for.

    lights          one after the other
    turn_light      the light turns once about +y
    turntable       the camera goes once around the hand
    pose            a recorded pose, "all" of them in their order, or "" for the first
    poses           poses from a file, in its order, instead of recorded ones
    camera          a recorded camera, or "" for the one that recorded the pose
    cameras         cameras from a file, instead of recorded ones: one, or a path that is followed
    yaw, pitch      degrees that the camera goes around the hand first; zoom enlarges
    size            pixels (width, height) of a picture; None: the camera's
    seconds, fps    how long each light is shown; None: as many frames as poses, or 4 seconds
    """

    lights: tuple[NamedLight, ...]
    turn_light: bool = False
    turntable: bool = False
    pose: str = ""
    poses: tuple[Pose, ...] = field(default=(), repr=False)
    camera: str = ""
    cameras: tuple[Camera, ...] = field(default=(), repr=False)
    yaw: float = 0.0
    pitch: float = 0.0
    zoom: float = 1.0
    size: tuple[int, int] | None = None
    seconds: float | None = None
    fps: float = 24.0

    @property
    def sequence(self) -> bool:
        """Whether poses follow each other."""
        return self.pose == "all" or len(self.poses) > 1

    @property
    def path(self) -> bool:
        """Whether the camera follows a path."""
        return len(self.cameras) > 1

    @property
    def moves(self) -> bool:
        return self.turn_light or not self.still_view

    @property
    def still_view(self) -> bool:
        """Whether hand and camera stand still."""
        return not (self.turntable or self.sequence or self.path)

    def said(self) -> dict[str, Any]:
        """All of it as JSON values, files by their content."""
        poses = [[part.tolist() for part in (p.joints, p.rotation, p.translation)] for p in self.poses]
        cameras = [[c.width, c.height, c.K.tolist(), c.world_to_camera.tolist()] for c in self.cameras]
        files = {"lights": [light.digest for light in self.lights], "poses": poses, "cameras": cameras}
        return {**asdict(replace(self, poses=(), cameras=())), **files}


@dataclass(frozen=True, eq=False)
class Shots:
    """The frames of a wish, for one portrait."""

    portrait: Portrait
    wish: Wish

    @cached_property
    def postures(self) -> tuple[Posture, ...]:
        """The poses in order, before they are spread over the frames."""
        wish, shown = self.wish, self.portrait.repertoire
        if wish.poses:
            return tuple(shown.posed(f"pose-{i:04d}", pose) for i, pose in enumerate(wish.poses))
        if wish.pose == "all":
            return tuple(shown.postures.values())
        return (shown.posture(wish.pose or shown.views[0][0]),)

    @cached_property
    def frames_of_a_light(self) -> int:
        """How many frames each light has. Raises `InputError` for a video that is too long or has none."""
        wish = self.wish
        if not wish.moves:
            return 1
        if wish.seconds is None and (wish.sequence or wish.path):
            return len(self.postures) if wish.sequence else len(wish.cameras)
        seconds = 4.0 if wish.seconds is None else wish.seconds
        count = round(seconds * wish.fps)
        if not 1 <= count * len(wish.lights) <= MOST_FRAMES:
            raise InputError(
                f"{seconds:g} seconds at {wish.fps:g} frames a second are {count} frames for each light; "
                f"give 1 to {MOST_FRAMES} frames in all"
            )
        return count

    def __len__(self) -> int:
        return self.frames_of_a_light * len(self.wish.lights)

    def check(self) -> None:
        """Raises `InputError` for a pose or camera that there is not, and for cameras from a file that see no hand or
        have pictures of different sizes; `Unsupported` for poses that cannot be shown."""
        cameras, shown = self.wish.cameras, self.portrait.repertoire
        self.viewpoint(0)
        sizes = {(camera.width, camera.height) for camera in cameras}
        if len(sizes) > 1 and self.wish.size is None:
            raise InputError(f"the cameras' pictures have {len(sizes)} sizes; give the one to draw with --size")
        middle = shown.middle(self.postures[0])
        if cameras and not any(_sees(camera, middle) for camera in cameras):
            away = min(float(np.linalg.norm(camera.centre - middle)) for camera in cameras)
            raise InputError(
                f"none of the cameras sees the hand of {self.portrait.name}, which is {away:.3g} m from the nearest; "
                "say which axis is up and what is counted in (:z-up, :y-down, :millimetres)"
            )

    def viewpoint(self, frame: int) -> Viewpoint:
        place = frame % self.frames_of_a_light
        posture = self._posture(place)
        return self.portrait.repertoire.viewpoint(posture, self._camera(place))

    def same_pose(self, one: int, other: int) -> bool:
        """Whether two frames show the same pose."""
        last = len(self.postures) - 1
        return self._along(one, last) == self._along(other, last)

    def light(self, frame: int, maps: Sequence[Environment]) -> Environment:
        """The light of a frame; `maps` are those of the wish."""
        which, place = divmod(frame, self.frames_of_a_light)
        if not self.wish.turn_light or place == 0:
            return maps[which]
        return rotate(maps[which], 2.0 * np.pi * place / self.frames_of_a_light)

    def _along(self, frame: int, last: int) -> float:
        """How far along poses or cameras a frame is, from 0 to the last."""
        count = self.frames_of_a_light
        return 0.0 if count == 1 else (frame % count) * last / (count - 1)

    def _posture(self, place: int) -> Posture:
        low, part = _parted(self._along(place, len(self.postures) - 1))
        if part == 0.0:
            return self.postures[low]
        before, after = self.postures[low], self.postures[low + 1]
        if before.pose is None or after.pose is None or self.portrait.repertoire.body is None:
            return before if part < 0.5 else after
        pose = between(before.pose, after.pose, part)
        return self.portrait.repertoire.posed(f"{before.name}+{part:.3f}", pose)

    def _camera(self, place: int) -> Camera:
        wish, shown = self.wish, self.portrait.repertoire
        first = self.postures[0]
        if wish.cameras:
            low, part = _parted(self._along(place, len(wish.cameras) - 1))
            camera = wish.cameras[low] if part == 0.0 else moved(wish.cameras[low], wish.cameras[low + 1], part)
        else:
            camera = shown.camera(wish.camera) if wish.camera else shown.camera_of(first.name)
        if wish.size is not None:
            camera = resized(camera, *wish.size)
        yaw = wish.yaw + (360.0 * place / self.frames_of_a_light if wish.turntable else 0.0)
        if (yaw, wish.pitch, wish.zoom) == (0.0, 0.0, 1.0):
            return camera
        return orbited(camera, shown.middle(first), yaw, wish.pitch, wish.zoom)


def _sees(camera: Camera, point: Array) -> bool:
    """Whether a hand at a point is before a camera, neither at the lens nor a dot, and in the picture or close by."""
    (place,), (depth,) = camera.project(point[None])
    size = np.array([camera.width, camera.height])
    large = _AT_LENS < depth < camera.K[0, 0] * _HAND / (_DOT * size.max())
    return bool(large and (place > -0.5 * size).all() and (place < 1.5 * size).all())


def _parted(along: float) -> tuple[int, float]:
    """The item that was passed last, and the share of the way to the next."""
    low = int(along + 1e-9)
    return low, max(along - low, 0.0) if along - low > 1e-9 else 0.0


def moved(one: Camera, other: Camera, share: float) -> Camera:
    """The camera a share of the way from one to another of the same size: turned along the shortest way, its centre and
    its lens in between."""
    turns = Slerp([0.0, 1.0], Rotation.from_matrix(np.stack([one.rotation, other.rotation])))
    rotation = turns(share).as_matrix()
    K, centre = ((1.0 - share) * a + share * b for a, b in ((one.K, other.K), (one.centre, other.centre)))
    return replace(one, K=K, world_to_camera=np.c_[rotation, -rotation @ centre])


def between(one: Pose, other: Pose, share: float) -> Pose:
    """The pose a share of the way from one to another: rotations along the shortest way."""
    turned = [
        np.stack([Slerp([0.0, 1.0], Rotation.from_rotvec(pair))(share).as_rotvec() for pair in pairs])
        for pairs in (
            np.stack([one.joints, other.joints], axis=1),
            np.stack([one.rotation, other.rotation], axis=0)[None],
        )
    ]
    return Pose(turned[0], turned[1][0], (1.0 - share) * one.translation + share * other.translation)
