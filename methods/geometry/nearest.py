"""The point of a surface nearest to each of some points, as a function of the surface."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from handbench.lean import open3d
from handbench.scene import Array

from ..kit.rows import rows_of

_TOGETHER = 1 << 21  # pairs of a point and a triangle that are compared at once: about 0.3 GB


def closest(vertices: Tensor, faces: Array, points: Tensor) -> Tensor:
    """The point of a surface nearest to each of points (N, 3), differentiable in its vertices (V, 3).

    On the CPU Embree finds the triangles; on another device each point is compared with all of them.
    """
    corners = torch.from_numpy(faces.astype(np.int64)).to(vertices.device)
    find = by_embree if vertices.device.type == "cpu" else by_all
    with torch.no_grad():
        face, u, v = find(vertices, corners, points)
    weights = torch.stack([1.0 - u - v, u, v], dim=-1)
    return (weights[..., None] * rows_of(vertices, corners[face])).sum(dim=1)


def by_embree(vertices: Tensor, corners: Tensor, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Triangle (N,) and barycentric u, v (N,) of the nearest points."""
    o3d = open3d()
    scene = o3d.t.geometry.RaycastingScene()
    tensor = o3d.core.Tensor.from_numpy
    scene.add_triangles(tensor(vertices.detach().numpy()), tensor(corners.numpy().astype(np.uint32)))
    found = scene.compute_closest_points(tensor(points.numpy()))
    u, v = torch.from_numpy(found["primitive_uvs"].numpy()).unbind(-1)
    return torch.from_numpy(found["primitive_ids"].numpy().astype(np.int64)), u, v


def by_all(vertices: Tensor, corners: Tensor, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The same without a tree: the foot in each triangle's plane, if it is inside, or on the nearest of its edges."""
    a, b, c = vertices.detach().double()[corners].unbind(dim=1)
    e, f = b - a, c - a
    ee, ef, ff = (e * e).sum(dim=1), (e * f).sum(dim=1), (f * f).sum(dim=1)
    tiny = torch.finfo(torch.float64).tiny
    area = ee * ff - ef * ef
    found = []
    for some in points.double().split(max(1, _TOGETHER // len(corners))):
        away = some[:, None] - a
        pe, pf = (away * e).sum(dim=2), (away * f).sum(dim=2)
        u = (ff * pe - ef * pf) / area.clamp_min(tiny)
        v = (ee * pf - ef * pe) / area.clamp_min(tiny)
        inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (area > 0.0)
        along_e, along_f = (pe / ee.clamp_min(tiny)).clamp(0.0, 1.0), (pf / ff.clamp_min(tiny)).clamp(0.0, 1.0)
        across = ((pf - pe + ee - ef) / (ee - 2.0 * ef + ff).clamp_min(tiny)).clamp(0.0, 1.0)
        nothing = torch.zeros_like(along_e)
        us = torch.stack([u, along_e, nothing, 1.0 - across])
        vs = torch.stack([v, nothing, along_f, across])
        apart = (away - us[..., None] * e - vs[..., None] * f).square().sum(dim=3)
        apart[0] = torch.where(inside, apart[0], torch.inf)
        least, way = apart.min(dim=0)
        face = least.argmin(dim=1)
        found.append((face, *(x.gather(0, way[None])[0].gather(1, face[:, None])[:, 0] for x in (us, vs))))
    face, u, v = (torch.cat(parts) for parts in zip(*found, strict=True))
    return face, u.to(vertices.dtype), v.to(vertices.dtype)
