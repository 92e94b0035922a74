"""Blend shapes, bone proportions and linear blend skinning as differentiable torch functions."""

from __future__ import annotations

import torch
from torch import Tensor


def rotation_matrix(axis_angle: Tensor) -> Tensor:
    """Rodrigues' formula: (..., 3) radians to (..., 3, 3), smooth at zero."""
    squared = (axis_angle**2).sum(-1)
    small = squared < max(1e-8, torch.finfo(axis_angle.dtype).tiny)
    safe = torch.where(small, torch.ones_like(squared), squared)
    angle = safe.sqrt()
    sinc = torch.where(small, 1 - squared / 6, angle.sin() / angle)
    cosc = torch.where(small, 0.5 - squared / 24, (1 - angle.cos()) / safe)
    x, y, z = axis_angle.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    eye = torch.eye(3, dtype=axis_angle.dtype, device=axis_angle.device)
    return eye + sinc[..., None, None] * cross + cosc[..., None, None] * (cross @ cross)


def proportion(
    vertices: Tensor,
    points: Tensor,
    ends: Tensor,
    parents: tuple[int, ...],
    weights: Tensor,
    length: Tensor,
    width: Tensor,
) -> tuple[Tensor, Tensor]:
    """Stretch each bone by length (J,) along and width (J,) across itself; what hangs on it moves along.

    vertices (V, 3), points (J + E, 3) joints and tips, ends (J,) the point that ends each bone, weights (V, J).
    Returns the changed vertices and points, with joint 1 (the wrist) kept where it was.
    """
    joints = len(parents)
    heads = points[:joints]
    reach = points[ends] - heads
    axis = torch.nn.functional.normalize(reach, dim=-1)
    along = axis[:, :, None] * axis[:, None, :]
    eye = torch.eye(3, dtype=vertices.dtype, device=vertices.device)
    stretch = width[:, None, None] * eye + (length - width)[:, None, None] * along
    still = _turned(stretch, heads)
    above = [max(parent, 0) for parent in parents]
    steps = _turned(stretch[above], heads - heads[above]).unbind()
    moved: list[Tensor] = []
    for j, parent in enumerate(parents):
        moved.append(still[j] if parent < 0 else moved[parent] + steps[j])
    new_heads = torch.stack(moved)
    tips = (new_heads + _turned(stretch, reach))[ends >= joints]
    blended = _blended(weights, stretch, new_heads - still, vertices)
    new_points = torch.cat([new_heads, tips])
    return blended - new_heads[1], new_points - new_heads[1]


def _turned(matrices: Tensor, rows: Tensor) -> Tensor:
    """Each row (N, 3) by its matrix (N, 3, 3)."""
    return (matrices @ rows[:, :, None])[..., 0]


def _blended(weights: Tensor, matrices: Tensor, offset: Tensor, vertices: Tensor) -> Tensor:
    """Vertices (V, 3) by the weighted means of the bones' maps, matrices (J, 3, 3) and offset (J, 3).

    One einsum of three operands says the same, and takes as long again to find the order of its products.
    """
    return _turned((weights @ matrices.flatten(1)).unflatten(1, (3, 3)), vertices) + weights @ offset


def linear_blend(
    vertices: Tensor,
    heads: Tensor,
    parents: tuple[int, ...],
    weights: Tensor,
    frames: Tensor,
    joint_rotations: Tensor,
    rotation: Tensor,
    translation: Tensor,
) -> Tensor:
    """Pose vertices (V, 3) with joints at heads (J, 3) by axis-angles (J, 3) in the joints' frames (J, 3, 3)."""
    turn, offset = joint_transforms(heads, parents, frames, joint_rotations)
    posed = _blended(weights, turn, offset, vertices)
    return posed @ rotation_matrix(rotation).T + translation


def joint_transforms(
    heads: Tensor, parents: tuple[int, ...], frames: Tensor, joint_rotations: Tensor
) -> tuple[Tensor, Tensor]:
    """Where each joint takes what is fixed to it: x -> turn x + offset, turn (J, 3, 3) and offset (J, 3).

    heads (J, 3) are the joints at rest; the rotations (J, 3) are axis-angles in the joints' frames (J, 3, 3).
    """
    local = frames @ rotation_matrix(joint_rotations) @ frames.transpose(-1, -2)
    rotations: list[Tensor] = []
    positions: list[Tensor] = []
    for j, parent in enumerate(parents):
        if parent < 0:
            rotations.append(local[j])
            positions.append(heads[j])
        else:
            rotations.append(rotations[parent] @ local[j])
            positions.append(positions[parent] + rotations[parent] @ (heads[j] - heads[parent]))
    turn = torch.stack(rotations)
    return turn, torch.stack(positions) - torch.einsum("jab,jb->ja", turn, heads)
