"""The surface at the texels: positions, smooth normals, and normals refined by a displacement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ...scene import Array, Mesh
from .atlas import Atlas
from .columns import at_corners, cross, inner, unit_columns


@dataclass(frozen=True)
class SurfaceMaps:
    """position (3, R, R) in metres, unit normal (3, R, R), both float32 and zero where not covered; covered (R, R)."""

    position: Tensor
    normal: Tensor
    covered: Tensor


def face_normals(vertices: Array, faces: Array) -> Array:
    """Unit normals (F, 3) of the faces, zero for degenerate ones."""
    a, b, c = at_corners(vertices, faces)
    return unit_columns(cross(b - a, c - a)).T


def vertex_normals(vertices: Array, faces: Array) -> Array:
    """Smooth unit normals (V, 3): face normals averaged with the angle at the vertex as weight.

    The angle weight does not depend on how a polygon was cut into triangles. Zero for unused vertices.
    """
    a, b, c = at_corners(vertices, faces)
    normals = unit_columns(cross(b - a, c - a))
    edges = [unit_columns(end - start) for start, end in ((a, b), (b, c), (c, a))]  # each leaves its corner
    total = np.zeros((3, len(vertices)))
    for k in range(3):
        angle = np.arccos(np.clip(-inner(edges[k], edges[k - 1]), -1.0, 1.0))
        for axis in range(3):
            total[axis] += np.bincount(faces[:, k], normals[axis] * angle, minlength=len(vertices))
    return np.ascontiguousarray(unit_columns(total).T)


def mesh_normals(mesh: Mesh) -> Array:
    """`vertex_normals` of a mesh."""
    return vertex_normals(mesh.vertices, mesh.topology.faces)


def surface_maps(mesh: Mesh, atlas: Atlas) -> SurfaceMaps:
    """Position and smooth normal of the mesh at every texel of the atlas."""
    position = torch.from_numpy(atlas.interpolate(mesh.vertices).T).float()
    normal = torch.from_numpy(unit_rows(atlas.interpolate(mesh_normals(mesh))).T).float()
    return SurfaceMaps(atlas.scatter(position), atlas.scatter(normal), torch.from_numpy(atlas.covered))


class Relief:
    """A coarse surface that displacements refine: positions and unit normals (3, N) at the texels of an atlas.

    With a = x_u + δ n_u and b = x_v + δ n_v taken in the tangent plane of n, the tangents of the displaced surface
    x + δ n are a + δ_u n and b + δ_v n, so its normal is along (a x b) + δ_u (n x b) + δ_v (a x n) (URHand Eq. 2).
    The first term is along n, hence δ = 0 gives back the smooth normal exactly. What does not depend on δ is worked
    out here, once a pose. Derivatives are central differences inside a chart and one-sided at its border; their
    common scale cancels.
    """

    def __init__(self, position: Tensor, normal: Tensor, atlas: Atlas) -> None:
        self.normal, self._atlas = normal, atlas
        derivatives = (*_differences(position, atlas), *_differences(normal, atlas))
        x_u, x_v, n_u, n_v = (values - _dot(values, normal) * normal for values in derivatives)
        flat, bend, twist = _dot_cross(x_u, x_v, normal), _dot_cross(x_u, n_v, normal), _dot_cross(n_u, x_v, normal)
        side = torch.where(flat < 0, -1.0, 1.0)
        scale = torch.where(flat.abs() <= 1e-20, 0.0, 1.0 / flat.abs())  # a chart one texel wide: nothing to tilt
        # the area of a x b along n over that of x_u x x_v is 1 + δ bend + δ² curvature
        self._bend = scale * side * (bend + twist)
        self._curvature = scale * side * _dot_cross(n_u, n_v, normal)
        self._tilts = tuple(
            scale * side * torch.linalg.cross(*pair, dim=-2)
            for pair in ((normal, x_v), (normal, n_v), (x_u, normal), (n_u, normal))
        )

    def refined(self, displacement: Tensor) -> Tensor:
        """Unit normals (..., 3, N) of the displaced surface from δ (..., 1, N) in metres; differentiable in δ.

        Where a fold would turn the surface inside out (δ beyond its radius of curvature) the area is held at a tenth.
        """
        along_u, along_v = _differences(displacement, self._atlas)
        by_u, by_u_more, by_v, by_v_more = self._tilts
        area = (1.0 + displacement * (self._bend + displacement * self._curvature)).clamp_min(0.1)
        tilt = along_u * (by_u + displacement * by_u_more) + along_v * (by_v + displacement * by_v_more)
        return unit(self.normal + tilt / area)


def _differences(values: Tensor, atlas: Atlas) -> tuple[Tensor, Tensor]:
    """Differences (..., C, N) of flat maps along u (right) and v (up) between neighbours in the same chart."""
    right, left, up, down = atlas.neighbours(values.device)

    def between(after: Tensor, before: Tensor) -> Tensor:
        return values.index_select(-1, after) - values.index_select(-1, before)

    return between(right, left), between(up, down)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(dim=-2, keepdim=True)


def _dot_cross(a: Tensor, b: Tensor, along: Tensor) -> Tensor:
    return _dot(torch.linalg.cross(a, b, dim=-2), along)


def unit(vectors: Tensor) -> Tensor:
    """Vectors (..., 3, N) made unit; zero stays zero. Several times faster than a norm along that axis."""
    return vectors * (vectors * vectors).sum(dim=-2, keepdim=True).clamp_min(1e-30).rsqrt()


def unit_rows(vectors: Array) -> Array:
    """Vectors (..., 3) made unit along the last axis; zero stays zero."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    length = np.sqrt(x * x + y * y + z * z)[..., None]  # a norm along rows of three is several times slower
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
