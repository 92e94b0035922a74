"""The frame of the surface at each texel: the texture's u axis, the axis across it, and the normal."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from handbench.render.uv.posed import PosedSurface
from handbench.render.uv.surface import unit


def tangent_frames(posed: PosedSurface) -> Tensor:
    """Rows tangent, bitangent, normal (3, 3, N) of each texel, unit and orthogonal, float32.

    `(tangent_frames(posed) * direction).sum(1)` turns directions (3, N) or (3, 1) of the world into the texels'
    frames. The tangent is that of the texel's triangle along u, made orthogonal to the smooth normal; it is zero,
    and the bitangent with it, where the triangle has no area.
    """
    topology, atlas = posed.mesh.topology, posed.atlas
    uvs, uv_faces = topology.unwrapped
    corners, uv = posed.mesh.vertices[topology.faces], uvs[uv_faces]
    (edge_a, edge_b), (a, b) = ((p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) for p in (corners, uv))
    turn = np.sign(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])[:, None]
    along = turn * (edge_a * b[:, 1:] - edge_b * a[:, 1:])  # ∂x/∂u up to a positive factor
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-20)
    normal = posed.normal
    tangent = torch.from_numpy(along[atlas.face].T).float().to(normal.device)
    tangent = unit(tangent - (tangent * normal).sum(0) * normal)
    return torch.stack([tangent, torch.linalg.cross(normal, tangent, dim=0), normal])
