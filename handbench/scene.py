"""What a light stage records and what a method is asked for: frozen values, validated at the border.

Units: metres, right-handed world, +y up; images linear Rec. 709, (H, W, 3) float32, premultiplied by
coverage over black. Cameras are OpenCV (x right, y down, z forward) with pixel centres at +0.5.
Light directions are unit vectors from the surface to the light.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError

Array: TypeAlias = NDArray[Any]


def _array(owner: str, name: str, value: ArrayLike, shape: tuple[int | None, ...], dtype: type) -> Array:
    """A read-only array of the given shape (None: any size), or an `InputError` that names what is wrong."""
    array: Array = np.asarray(value, dtype=dtype)
    fits = array.ndim == len(shape) and all(s is None or s == n for s, n in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = "(" + ", ".join("n" if s is None else str(s) for s in shape) + ")"
        raise InputError(f"{owner}: {name} has shape {array.shape}, expected {wanted}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        bad = int(np.count_nonzero(~np.isfinite(array)))
        raise InputError(f"{owner}: {name} holds {bad} values that are NaN or infinite; remove them first")
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array


def _set(instance: object, name: str, value: object) -> None:
    object.__setattr__(instance, name, value)


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera: K (3, 3) in pixels, world_to_camera (3, 4) rigid, width and height in pixels."""

    name: str
    width: int
    height: int
    K: Array
    world_to_camera: Array

    def __post_init__(self) -> None:
        owner = f"camera {self.name!r}"
        if self.width < 1 or self.height < 1:
            raise InputError(f"{owner}: size {self.width}x{self.height} must be at least 1x1")
        _set(self, "K", _array(owner, "K", self.K, (3, 3), np.float64))
        _set(self, "world_to_camera", _array(owner, "world_to_camera", self.world_to_camera, (3, 4), np.float64))
        if abs(np.linalg.det(self.K)) < 1e-12:
            raise InputError(f"{owner}: K has no inverse; give focal lengths in pixels")
        rotation = self.world_to_camera[:, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) or np.linalg.det(rotation) < 0:
            raise InputError(f"{owner}: world_to_camera is not a rigid transform; check its handedness and scale")

    @property
    def centre(self) -> Array:
        """Position of the camera in the world, (3,) metres."""
        return -self.world_to_camera[:, :3].T @ self.world_to_camera[:, 3]


@dataclass(frozen=True, eq=False)
class Directional:
    """A distant light: unit direction (3,) to the light, irradiance (3,) on a surface that faces it."""

    direction: Array
    irradiance: Array

    def __post_init__(self) -> None:
        direction = _array("directional light", "direction", self.direction, (3,), np.float64)
        if abs(np.linalg.norm(direction) - 1.0) > 1e-4:
            raise InputError(f"directional light: direction {direction.tolist()} is not a unit vector; normalise it")
        _set(self, "direction", direction)
        _set(self, "irradiance", _nonnegative("directional light", "irradiance", self.irradiance, (3,), np.float64))

    def scaled(self, factor: float) -> Directional:
        return Directional(self.direction, self.irradiance * factor)


@dataclass(frozen=True, eq=False)
class Point:
    """A near light: position (3,) in metres, radiant intensity (3,) per steradian."""

    position: Array
    intensity: Array

    def __post_init__(self) -> None:
        _set(self, "position", _array("point light", "position", self.position, (3,), np.float64))
        _set(self, "intensity", _nonnegative("point light", "intensity", self.intensity, (3,), np.float64))

    def scaled(self, factor: float) -> Point:
        return Point(self.position, self.intensity * factor)


@dataclass(frozen=True, eq=False)
class Environment:
    """Distant radiance (H, W, 3) in all directions: equirectangular, row 0 = +y, see `handbench.light`."""

    name: str
    radiance: Array

    def __post_init__(self) -> None:
        owner = f"environment {self.name!r}"
        radiance = _nonnegative(owner, "radiance", self.radiance, (None, None, 3), np.float32)
        if radiance.size == 0:
            raise InputError(f"{owner}: radiance is empty; give at least one texel")
        _set(self, "radiance", radiance)

    def scaled(self, factor: float) -> Environment:
        return Environment(self.name, self.radiance * np.float32(factor))


@dataclass(frozen=True, eq=False)
class Group:
    """Several lights at once; light adds."""

    lights: tuple[Light, ...]

    def __post_init__(self) -> None:
        _set(self, "lights", tuple(self.lights))

    def scaled(self, factor: float) -> Group:
        return Group(tuple(light.scaled(factor) for light in self.lights))


Light: TypeAlias = Directional | Point | Environment | Group


def _nonnegative(owner: str, name: str, value: ArrayLike, shape: tuple[int | None, ...], dtype: type) -> Array:
    array = _array(owner, name, value, shape, dtype)
    if (array < 0).any():
        raise InputError(f"{owner}: {name} has negative values (least {array.min():g}); light cannot be negative")
    return array


def leaves(light: Light) -> Iterator[Directional | Point | Environment]:
    """The single lights of a light, groups opened in order."""
    if isinstance(light, Group):
        for member in light.lights:
            yield from leaves(member)
    else:
        yield light


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


@dataclass(frozen=True, eq=False)
class Topology:
    """What all meshes of a capture share: faces (F, 3), UVs (T, 2) in [0, 1], faces into the UVs (F, 3)."""

    faces: Array
    uvs: Array
    uv_faces: Array

    def __post_init__(self) -> None:
        _set(self, "faces", _array("topology", "faces", self.faces, (None, 3), np.int32))
        uvs = np.zeros((0, 2)) if self.uvs is None else np.asarray(self.uvs)
        if uvs.size == 0:
            raise InputError("topology: the mesh has no UVs; handbench works in UV space, so unwrap it first")
        _set(self, "uvs", _array("topology", "uvs", uvs, (None, 2), np.float64))
        _set(self, "uv_faces", _array("topology", "uv_faces", self.uv_faces, self.faces.shape, np.int32))
        if len(self.uv_faces) and (self.uv_faces.min() < 0 or self.uv_faces.max() >= len(self.uvs)):
            raise InputError(f"topology: uv_faces points outside the {len(self.uvs)} UVs; the mesh file is damaged")


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
class Query:
    """What a method is asked to draw: an enrolled subject, posed, seen by a camera, under a light.

    `key` names the frame ("subject/pose/camera/lighting"); equal `pose_key`s share mesh and pose, so
    a method may keep what it computed for one.
    """

    subject: str
    pose_name: str
    lighting: str
    pose: Pose
    mesh: Mesh
    camera: Camera
    light: Light

    @property
    def pose_key(self) -> str:
        return f"{self.subject}/{self.pose_name}"

    @property
    def key(self) -> str:
        return f"{self.pose_key}/{self.camera.name}/{self.lighting}"


@dataclass(frozen=True, eq=False)
class Frame(Query):
    """A recorded frame: a query whose answer was photographed. `kind`: olat, group, full or environment."""

    segment: str
    kind: str

    @property
    def query(self) -> Query:
        """The frame without what only the recording knows."""
        return Query(self.subject, self.pose_name, self.lighting, self.pose, self.mesh, self.camera, self.light)


@dataclass(frozen=True, eq=False)
class Observation:
    """What was recorded in a frame: image (H, W, 3) and alpha (H, W), and the geometry channels there are.

    normal (H, W, 3) in world space, depth (H, W) in metres along z, uv (H, W, 2); zero where alpha is zero.
    """

    image: Array
    alpha: Array
    normal: Array | None = None
    depth: Array | None = None
    uv: Array | None = None

    def __post_init__(self) -> None:
        image = _array("observation", "image", self.image, (None, None, 3), np.float32)
        _set(self, "image", image)
        height, width = image.shape[:2]
        _set(self, "alpha", _array("observation", "alpha", self.alpha, (height, width), np.float32))
        for name, channels in (("normal", (3,)), ("depth", ()), ("uv", (2,))):
            value = getattr(self, name)
            if value is not None:
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
        image = np.asarray(self.image, dtype=np.float32)
        alpha = np.asarray(self.alpha, dtype=np.float32)
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
