"""The surface of a hand: a triangle mesh, and the faces and UVs that all meshes of a capture share."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError, Unsupported
from .arrays import Array
from .arrays import checked as _array
from .arrays import put as _set

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
        _set(self, "vertices", _checked(self.vertices, self.topology))

    @staticmethod
    def unread(read: Callable[[], Array], topology: Topology) -> Mesh:
        """A mesh whose vertices (V, 3) `read()` gives when they are first looked at, in an array of its own, so that
        frames by the million stay light. What `read` raises is raised there."""
        made = object.__new__(Mesh)
        _set(made, "_read", read)
        _set(made, "topology", topology)
        return made

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> object:
            """The vertices that are not there yet."""
            if name != "vertices" or "_read" not in vars(self):
                raise AttributeError(f"a mesh has no {name}")
            _set(self, "vertices", _checked(vars(self)["_read"](), self.topology))
            return vars(self)["vertices"]


def _checked(vertices: Array, topology: Topology) -> Array:
    array = _array("mesh", "vertices", vertices, (None, 3), np.float64)
    faces = topology.faces
    if len(faces) and (faces.min() < 0 or faces.max() >= len(array)):
        raise InputError(f"mesh: faces point outside the {len(array)} vertices; the mesh file is damaged")
    return array
