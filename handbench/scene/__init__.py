"""What a light stage records and what a method is asked for: frozen values, validated at the border.

Units: metres, right-handed world, +y up; images linear Rec. 709, (H, W, 3) float32, premultiplied by
coverage over black. Cameras are OpenCV (x right, y down, z forward) with pixel centres at +0.5.
Light directions are unit vectors from the surface to the light.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError, Unsupported
from .arrays import Array
from .arrays import checked as _array
from .arrays import measured as _measured
from .arrays import put as _set
from .camera import Box, Camera, Uncalibrated
from .light import (
    FRAME_KINDS,
    KNOWN_LIGHTS,
    LIGHT_KINDS,
    Directional,
    Environment,
    FrameKind,
    Group,
    Known,
    Light,
    LightKind,
    Point,
    Single,
    Unknown,
    check_frame_kind,
    check_light,
    kind_of,
    known_leaves,
    leaves,
)

__all__ = [
    "FRAME_KINDS",
    "KNOWN_LIGHTS",
    "LIGHT_KINDS",
    "Array",
    "Box",
    "Camera",
    "Directional",
    "Environment",
    "Frame",
    "FrameKind",
    "Group",
    "Known",
    "Light",
    "LightKind",
    "Mesh",
    "Observation",
    "Point",
    "Pose",
    "Prediction",
    "Query",
    "Single",
    "Topology",
    "Uncalibrated",
    "Unknown",
    "Viewpoint",
    "check_frame_kind",
    "kind_of",
    "known_leaves",
    "leaves",
    "needed",
]


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


_UV_SLACK = 1e-4  # that rounding may take a UV out of [0, 1]


@dataclass(frozen=True, eq=False)
class Topology:
    """What all meshes of a capture share: faces (F, 3), and, if it is unwrapped, its UVs.

    uvs (T, 2) in [0, 1] and uv_faces (F, 3) into them; both None for a surface without UVs.
    """

    faces: Array
    uvs: Array | None = None
    uv_faces: Array | None = None

    def __post_init__(self) -> None:
        _set(self, "faces", _array("topology", "faces", self.faces, (None, 3), np.int32))
        if (self.uvs is None) != (self.uv_faces is None):
            missing = "uvs" if self.uvs is None else "uv_faces"
            raise InputError(f"topology: {missing} is missing; give uvs and uv_faces, or neither")
        if self.uvs is not None and self.uv_faces is not None:
            if np.asarray(self.uvs).size == 0:
                raise InputError("topology: uvs is empty; unwrap the mesh, or leave out uvs and uv_faces")
            _set(self, "uvs", _array("topology", "uvs", self.uvs, (None, 2), np.float64))
            low, high = float(self.uvs.min()), float(self.uvs.max())
            if low < -_UV_SLACK or high > 1.0 + _UV_SLACK:
                raise InputError(
                    f"topology: uvs reach from {low:g} to {high:g}, expected 0 to 1; pack the charts into one texture"
                )
            _set(self, "uv_faces", _array("topology", "uv_faces", self.uv_faces, self.faces.shape, np.int32))
            if len(self.uv_faces) and (self.uv_faces.min() < 0 or self.uv_faces.max() >= len(self.uvs)):
                raise InputError(f"topology: uv_faces points outside the {len(self.uvs)} UVs; the mesh file is damaged")

        content = hashlib.blake2b(digest_size=16)
        for array in (self.faces, *(() if self.uvs is None else self.unwrapped)):
            content.update(repr(array.shape).encode())
            content.update(np.ascontiguousarray(array).data)
        _set(self, "_digest", content.hexdigest())

    @property
    def unwrapped(self) -> tuple[Array, Array]:
        """uvs (T, 2) and uv_faces (F, 3). Raises `Unsupported` if there are none."""
        if self.uvs is None or self.uv_faces is None:
            raise Unsupported("the mesh has no UVs, and this works on a texture; unwrap the mesh")
        return self.uvs, self.uv_faces

    @property
    def digest(self) -> str:
        """Hex digest of the content: topologies of equal digest are the same."""
        return vars(self)["_digest"]


@dataclass(frozen=True, eq=False)
class Mesh:
    """A posed surface: vertices (V, 3) in metres over a shared topology."""

    vertices: Array
    topology: Topology

    def __post_init__(self) -> None:
        _set(self, "vertices", _array("mesh", "vertices", self.vertices, (None, 3), np.float64))
        faces = self.topology.faces
        if len(faces) and (faces.min() < 0 or faces.max() >= len(self.vertices)):
            raise InputError(f"mesh: faces point outside the {len(self.vertices)} vertices; the mesh file is damaged")


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

    `shape` holds the coefficients (n,) of the subject in the capture's hand model, None where there are none.
    """

    segment: str
    kind: FrameKind
    shape: Array | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_frame_kind(f"frame {self.key!r}", self.kind)
        if self.shape is not None:
            _set(self, "shape", _array("frame", "shape", self.shape, (None,), np.float64))

    @property
    def query(self) -> Query:
        """The frame without what only the recording knows."""
        return Query(self.subject, self.pose_name, self.lighting, self.pose, self.mesh, self.camera, self.light)


@dataclass(frozen=True, eq=False)
class Observation:
    """What was recorded in a frame: image (H, W, 3), and alpha (H, W) and geometry channels where there are any.

    normal (H, W, 3) in world space, depth (H, W) in metres along z, uv (H, W, 2); zero where alpha is zero.
    """

    image: Array
    alpha: Array | None = None
    normal: Array | None = None
    depth: Array | None = None
    uv: Array | None = None

    def __post_init__(self) -> None:
        given = _measured("observation", "image", self.image)
        image = _array("observation", "image", given, (None, None, 3), np.float32)
        _set(self, "image", image)
        height, width = image.shape[:2]
        for name, channels in (("alpha", ()), ("normal", (3,)), ("depth", ()), ("uv", (2,))):
            value = getattr(self, name)
            if value is not None:
                value = _measured("observation", name, value)
                _set(self, name, _array("observation", name, value, (height, width, *channels), np.float32))


@dataclass(frozen=True, eq=False)
class Prediction:
    """A method's answer to a query: image (H, W, 3), linear, premultiplied, and alpha (H, W).

    What it knows of the geometry it drew may come along: depth (H, W) in metres along the camera's z and normal
    (H, W, 3), unit, in world space, both of the visible surface and zero where there is none; a mesh; joints (J, 3)
    in metres. Depth and normal may be anything with a `shape` that numpy can read: they are worked out (`__array__`)
    if something asks for them. Give what the method found; what it was given is no answer.

    Values are not checked for NaN here: a method that diverges must be seen, so scoring does it.
    """

    image: Array
    alpha: Array
    depth: ArrayLike | None = None
    normal: ArrayLike | None = None
    mesh: Mesh | None = None
    joints: Array | None = None

    def __post_init__(self) -> None:
        image = _measured("prediction", "image", self.image).astype(np.float32, copy=False)
        alpha = _measured("prediction", "alpha", self.alpha).astype(np.float32, copy=False)
        if image.ndim != 3 or image.shape[2] != 3 or alpha.shape != image.shape[:2]:
            raise InputError(
                f"prediction: image {image.shape} and alpha {alpha.shape} do not fit; expected (H, W, 3) and (H, W)"
            )
        for name, channels in (("depth", ()), ("normal", (3,))):
            value, expected = getattr(self, name), (*alpha.shape, *channels)
            if value is not None and np.shape(value) != expected:
                raise InputError(f"prediction: {name} has shape {np.shape(value)}, expected {expected} as its image")
        if not isinstance(self.mesh, Mesh | None):
            raise InputError(f"prediction: mesh is a {type(self.mesh).__name__}; give a handbench.scene.Mesh")
        if self.joints is not None:
            joints = np.asarray(self.joints, dtype=np.float64)
            if joints.ndim != 2 or joints.shape[1] != 3:
                raise InputError(f"prediction: joints have shape {joints.shape}, expected (n, 3)")
            _set(self, "joints", joints)
        _set(self, "image", image)
        _set(self, "alpha", alpha)
