"""A posed mesh with what seeing and shading need of it: normals, and rays against it."""

from __future__ import annotations

from functools import cached_property

from ...scene import Array, Mesh, Topology
from ..uv.surface import vertex_normals
from .rays import RayScene


class PosedMesh:
    """A mesh whose normals and rays are worked out once, when they are first asked for.

    It is made for as long as one pose is drawn and dropped with it: meshes themselves are light and kept by the
    thousand, their ray scenes are not.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.vertices: Array = mesh.vertices
        self.topology: Topology = mesh.topology

    @staticmethod
    def of(mesh: Mesh | PosedMesh) -> PosedMesh:
        """The posed mesh of a mesh; one that is posed already is given back."""
        return mesh if isinstance(mesh, PosedMesh) else PosedMesh(mesh)

    @cached_property
    def normals(self) -> Array:
        """Smooth unit normals (V, 3), see `vertex_normals`."""
        return vertex_normals(self.vertices, self.topology.faces)

    @cached_property
    def rays(self) -> RayScene:
        """The ray scene of the mesh."""
        return RayScene(self.vertices, self.topology.faces)
