"""A subject in a pose (a viewpoint), the picture asked of it under a light (a query), and the one taken (a frame)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from ..errors import Unsupported
from .arrays import Array
from .arrays import checked as _array
from .arrays import put as _set
from .camera import Camera
from .light import FRAME_KINDS, FrameKind, Light, check_frame_kind, check_light
from .mesh import Mesh

_Part = TypeVar("_Part")


def needed(value: _Part | None, part: str) -> _Part:
    """A part of a frame, a viewpoint or an observation that must be there; `part` names it.

    Raises `Unsupported` if it was not recorded, or a protocol does not give it. A method that says so in
    `MethodInfo.needs` is refused before it trains.
    """
    if value is None:
        raise Unsupported(f"the {part} is not given")
    return value


@dataclass(frozen=True, eq=False)
class Pose:
    """Joint rotations (J, 3) as axis-angle in radians, and the rigid placement of the wrist in the world.

    The joints are those of the capture's hand model, in its order; rotation (3,) is axis-angle.
    """

    joints: Array
    rotation: Array = field(default_factory=lambda: np.zeros(3))
    translation: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        _set(self, "joints", _array("pose", "joints", self.joints, (None, 3), np.float64))
        _set(self, "rotation", _array("pose", "rotation", self.rotation, (3,), np.float64))
        _set(self, "translation", _array("pose", "translation", self.translation, (3,), np.float64))

    @staticmethod
    def unread(read: Callable[[], Pose]) -> Pose:
        """A pose that `read()` gives when it is first looked at, so that frames by the million stay light.

        What `read` raises is raised there.
        """
        made = object.__new__(Pose)
        _set(made, "_read", read)
        return made

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> object:
            """A field that is not there yet."""
            if name not in ("joints", "rotation", "translation") or "_read" not in vars(self):
                raise AttributeError(f"a pose has no {name}")
            vars(self).update(vars(vars(self)["_read"]()))
            return vars(self)[name]


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A subject in a pose, seen by a camera: all that a picture needs but the light.

    `key` names it ("subject/pose/camera"); viewpoints of equal `pose_key` show the same pose and mesh. Pose or mesh are
    None where they were not recorded, and where a protocol does not give them: see `needed`.
    """

    subject: str
    pose_name: str
    pose: Pose | None
    mesh: Mesh | None
    camera: Camera

    @property
    def pose_key(self) -> str:
        return f"{self.subject}/{self.pose_name}"

    @property
    def key(self) -> str:
        return f"{self.pose_key}/{self.camera.name}"


@dataclass(frozen=True, eq=False)
class Query:
    """What a method is asked to draw: an enrolled subject, posed, seen by a camera, under a light.

    `key` names the frame ("subject/pose/camera/lighting"); queries of equal `pose_key` show the same pose and mesh.
    """

    subject: str
    pose_name: str
    lighting: str
    pose: Pose | None
    mesh: Mesh | None
    camera: Camera
    light: Light

    def __post_init__(self) -> None:
        if not isinstance(self.light, Light):  # the key is put together for the message alone
            check_light(f"query {self.key!r}", self.light)

    @property
    def pose_key(self) -> str:
        return f"{self.subject}/{self.pose_name}"

    @property
    def key(self) -> str:
        return f"{self.viewpoint.key}/{self.lighting}"

    @property
    def viewpoint(self) -> Viewpoint:
        """The query without its light."""
        return Viewpoint(self.subject, self.pose_name, self.pose, self.mesh, self.camera)


@dataclass(frozen=True, eq=False)
class Frame(Query):
    """A recorded frame: a query whose answer was photographed. `kind` tells how it was lit.

    `shape` holds the coefficients (n,) of the subject in the capture's hand model, None where there are none. `moment`
    is the frame's place in a sequence, from 0; None where poses have no order in time.
    """

    segment: str
    kind: FrameKind
    shape: Array | None = None
    moment: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind not in FRAME_KINDS:
            check_frame_kind(f"frame {self.key!r}", self.kind)
        if self.shape is not None:
            _set(self, "shape", _array("frame", "shape", self.shape, (None,), np.float64))

    def seen_by(self, camera: Camera) -> Frame:
        """What another camera took at the same moment in the same light. What was checked is not checked again: this is
        for captures of a million frames."""
        made = object.__new__(type(self))
        fields = vars(self).copy()  # which shares the names of the fields, as a dict that is built anew would not
        fields["camera"] = camera
        _set(made, "__dict__", fields)
        return made

    @property
    def query(self) -> Query:
        """The frame without what only the recording knows."""
        return Query(self.subject, self.pose_name, self.lighting, self.pose, self.mesh, self.camera, self.light)
