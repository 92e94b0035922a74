"""The surface at the texels: positions, smooth normals, and normals refined by a displacement map."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from ..scene import Array, Mesh
from .atlas import Atlas


@dataclass(frozen=True)
class SurfaceMaps:
    """position (3, R, R) in metres, unit normal (3, R, R), both float32 and zero where not covered; covered (R, R)."""

    position: Tensor
    normal: Tensor
    covered: Tensor


def face_normals(vertices: Array, faces: Array) -> Array:
    """Unit normals (F, 3) of the faces, zero for degenerate ones."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return _unit(np.cross(b - a, c - a))


def vertex_normals(vertices: Array, faces: Array) -> Array:
    """Smooth unit normals (V, 3): face normals averaged with the angle at the vertex as weight.

    The angle weight does not depend on how a polygon was cut into triangles. Zero for unused vertices.
    """
    normals = face_normals(vertices, faces)
    total = np.zeros((len(vertices), 3))
    for k in range(3):
        corner, after, before = (vertices[faces[:, (k + step) % 3]] for step in range(3))
        cosine = (_unit(after - corner) * _unit(before - corner)).sum(axis=1)
        weighted = normals * np.arccos(np.clip(cosine, -1.0, 1.0))[:, None]
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, k], weighted[:, axis], minlength=len(vertices))
    return _unit(total)


@lru_cache(maxsize=8)
def mesh_normals(mesh: Mesh) -> Array:
    """`vertex_normals` of a mesh; the last few are kept."""
    return vertex_normals(mesh.vertices, mesh.topology.faces)


def surface_maps(mesh: Mesh, atlas: Atlas) -> SurfaceMaps:
    """Position and smooth normal of the mesh at every texel of the atlas."""
    position = torch.from_numpy(atlas.interpolate(mesh.vertices).T).float()
    normal = torch.from_numpy(_unit(atlas.interpolate(mesh_normals(mesh))).T).float()
    return SurfaceMaps(atlas.scatter(position), atlas.scatter(normal), torch.from_numpy(atlas.covered))


def refine(position: Tensor, normal: Tensor, displacement: Tensor, atlas: Atlas) -> Tensor:
    """Normals of the displaced surface x + δ n, (..., 3, R, R), from δ (..., 1, R, R) in metres (URHand Eq. 2).

    With a = x_u + δ n_u and b = x_v + δ n_v taken in the tangent plane of n, the tangents of the displaced
    surface are a + δ_u n and b + δ_v n, so its normal is along (a x b) + δ_u (n x b) + δ_v (a x n). The first
    term is along n, hence δ = 0 gives back the smooth normal exactly. Derivatives are central differences
    inside a chart and one-sided at its border; their common scale cancels. Where a fold would turn the
    surface inside out (δ beyond its radius of curvature) the area is held at a tenth. Differentiable in δ.
    """
    x, n, delta = atlas.gather(position), atlas.gather(normal), atlas.gather(displacement)
    (x_u, x_v), (n_u, n_v), (delta_u, delta_v) = (_differences(values, atlas) for values in (x, n, delta))
    x_u, x_v, n_u, n_v = (_tangential(values, n) for values in (x_u, x_v, n_u, n_v))
    area = _dot(torch.linalg.cross(x_u, x_v, dim=-2), n)
    side = torch.where(area < 0, -1.0, 1.0)
    a, b = x_u + delta * n_u, x_v + delta * n_v
    displaced = torch.maximum(side * _dot(torch.linalg.cross(a, b, dim=-2), n), 0.1 * area.abs())
    tilt = delta_u * torch.linalg.cross(*torch.broadcast_tensors(n, b), dim=-2)
    tilt = tilt + delta_v * torch.linalg.cross(*torch.broadcast_tensors(a, n), dim=-2)
    # metres squared per texel squared is tiny: divide by the area before normalising
    flat = area.abs() <= 1e-20  # a chart one texel wide: no tangent plane to tilt
    slope = torch.where(flat, 0.0, side * tilt / torch.where(flat, 1.0, displaced))
    return atlas.scatter(unit(n + slope))


def _differences(values: Tensor, atlas: Atlas) -> tuple[Tensor, Tensor]:
    """Differences (..., C, N) of flat maps along u (right) and v (up) between neighbours in the same chart."""
    right, left, up, down = _neighbours(atlas)

    def between(after: Tensor, before: Tensor) -> Tensor:
        return values.index_select(-1, after) - values.index_select(-1, before)

    return between(right, left), between(up, down)


@lru_cache(maxsize=16)
def _neighbours(atlas: Atlas) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """For each covered texel the flat index of its right, left, upper and lower neighbour, or its own."""
    own = np.arange(atlas.count)
    where = np.full((atlas.size + 2, atlas.size + 2), -1)  # padded by one texel, so borders need no special case
    row, column = atlas.texels // atlas.size + 1, atlas.texels % atlas.size + 1
    where[row, column] = own

    def neighbour(down: int, right: int) -> Tensor:
        other = where[row + down, column + right]
        same = (other >= 0) & (atlas.chart[other] == atlas.chart)
        return torch.from_numpy(np.where(same, other, own))

    return neighbour(0, 1), neighbour(0, -1), neighbour(-1, 0), neighbour(1, 0)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(dim=-2, keepdim=True)


def unit(vectors: Tensor) -> Tensor:
    """Vectors (..., 3, N) made unit; zero stays zero. Several times faster than a norm along that axis."""
    return vectors * (vectors * vectors).sum(dim=-2, keepdim=True).clamp_min(1e-30).rsqrt()


def _tangential(values: Tensor, normal: Tensor) -> Tensor:
    return values - _dot(values, normal) * normal


def _unit(vectors: Array) -> Array:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
