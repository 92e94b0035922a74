"""What is traced: a finely meshed surface with its textures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.ndimage import map_coordinates

from ....render.uv.surface import mesh_normals
from ....scene import Array, Mesh


@dataclass(frozen=True, eq=False)
class TracedSurface:
    """A mesh with smooth normals, albedo (R, R, 3) linear, roughness (R, R); row 0 = top.

    Light is worked out at the vertices, so they must be about as fine as shadows should be sharp.
    roughness is that of the sharper of two specular lobes; specular: reflectance knob of the principled BSDF (0.42 is
    an index of refraction of 1.45, dry skin). bump (R, R): relief in metres too fine for the mesh, which tilts the
    shading normal. mean_free_path (R, R, 3) or (3,): how far light wanders under the surface, the diffuse mean free
    path in metres per channel, 0 where nothing scatters; None: light leaves where it arrives (the surface model).
    """

    mesh: Mesh
    albedo: Array
    roughness: Array
    specular: float = 0.42
    bump: Array | None = None
    mean_free_path: Array | None = None


class Displaced(Protocol):
    """Anything with a displacement map (R, R), metres along the normal, row 0 = top."""

    @property
    def displacement(self) -> Array: ...


def displace(mesh: Mesh, skin: Displaced) -> Mesh:
    """The mesh with its vertices moved along their smooth normals by the displacement read at their UVs (bilinear).

    A vertex with several UVs, on a seam, moves by the mean over its faces, so the surface stays closed.
    """
    offset = at_vertices(mesh, np.asarray(skin.displacement, np.float64))
    return Mesh(mesh.vertices + mesh_normals(mesh) * offset[:, None], mesh.topology)


def read(texture: Array, uv: Array) -> Array:
    """A texture (R, R) or (R, R, C) at uv (N, 2), bilinear: (N,) or (N, C) float64; row 0 = top."""
    size = texture.shape[0]
    at = np.stack([(1 - uv[:, 1]) * size - 0.5, uv[:, 0] * texture.shape[1] - 0.5])
    layers = texture.reshape(*texture.shape[:2], -1)
    found = [
        map_coordinates(np.asarray(layers[..., k], np.float64), at, order=1, mode="nearest")
        for k in range(layers.shape[2])
    ]
    return found[0] if texture.ndim == 2 else np.stack(found, axis=1)


def at_vertices(mesh: Mesh, texture: Array) -> Array:
    """A texture at the vertices, (V,) or (V, C); on seams the mean over the faces."""
    uvs, uv_faces = mesh.topology.unwrapped
    corner = mesh.topology.faces.ravel()
    count = np.maximum(np.bincount(corner, minlength=len(mesh.vertices)), 1)
    values = read(texture, uvs)[uv_faces.ravel()]
    columns = values.reshape(len(corner), -1).T
    found = [np.bincount(corner, column, minlength=len(mesh.vertices)) / count for column in columns]
    return found[0] if texture.ndim == 2 else np.stack(found, axis=1)
