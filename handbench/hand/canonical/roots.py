"""Where posed points came from: the roots of skinning (SNARF, Chen et al. 2021; Broyden's method as its authors do)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import torch
from torch import Tensor

from ...errors import InputError
from .deformation import MOST, Deformation

CONVERGED = 1e-5
"""Metres: a root's image is closer to its point."""
MERGED = 1e-4
"""Metres: closer roots are one."""

_DIVERGED = 0.1  # metres
_STEPS = 10
_GUARD = 1e-12  # least denominator of Broyden's update


@dataclass(frozen=True)
class AllBones:
    """Search from every bone: where the point would be if that bone alone had moved it (SNARF, PALM-Net)."""


@dataclass(frozen=True)
class NearestBones:
    """Search from the `count` bones whose skin is nearest, 1 to 4 of them, each from its nearest vertex.

    Points that are more than 22 mm from the posed skin are not searched and have no root. Two bones find both roots
    between touching fingers; where more sheets meet, as in a fist, ask for more.
    """

    count: int = 2

    def __post_init__(self) -> None:
        if not 1 <= self.count <= MOST:
            raise InputError(
                f"roots from the nearest {self.count} bones are not searched; give 1 to {MOST}, or `AllBones`"
            )


Starts: TypeAlias = AllBones | NearestBones


@dataclass(frozen=True, eq=False)
class Roots:
    """Candidates x (N, K, 3) in canonical space for N posed points, and which of them are roots, valid (N, K).

    Roots that are the same count once. What is in x where `valid` is false means nothing.
    """

    x: Tensor
    valid: Tensor


@torch.no_grad()
def canonicalise(deformation: Deformation, points: Tensor, starts: Starts | None = None) -> Roots:
    """All canonical points that the deformation takes to points (N, 3) of the hand frame, without gradients.

    Broyden's good method from each start, with the transposed blended rotation there as the first inverse Jacobian;
    at most 10 steps. A root is within 1e-5 m of its point and inside the field's lattice.
    """
    starts = starts or NearestBones()
    target, x, inverse, rows, columns, count = _starting(deformation, points, starts)
    found, done = _broyden(deformation, target, x, inverse)
    roots = points.new_zeros(len(points), count, 3)
    valid = torch.zeros(len(points), count, dtype=torch.bool)
    roots[rows, columns] = found
    valid[rows, columns] = done & deformation.field.lattice.inside(found)
    for later in range(1, count):
        for earlier in range(later):
            same = (roots[:, later] - roots[:, earlier]).square().sum(dim=1) < MERGED**2
            valid[:, later] &= ~(same & valid[:, earlier])
    return Roots(roots, valid)


def attached(deformation: Deformation, points: Tensor, x: Tensor) -> Tensor:
    """Roots x (N, 3) of points (N, 3), with the gradients of the implicit function theorem.

    x* - J^-1 (forward(x*) - point): J is the exact Jacobian of the deformation at the root and no gradient goes through
    it. The value is x itself, but for what a last step of Newton's method mends. Where J is singular, in a crease
    that is folded up, the gradient is that of its pseudo-inverse.
    """
    x = x.detach()
    with torch.no_grad():
        inverse = _inverse(deformation.jacobian(x))
    missed = deformation.forward(x) - points
    return x - (inverse @ missed[..., None]).squeeze(2)


def _inverse(matrices: Tensor) -> Tensor:
    """Inverses (N, 3, 3); pseudo-inverses of what has none."""
    inverse, info = torch.linalg.inv_ex(matrices)
    bad = (info != 0) | (inverse.abs().amax(dim=(1, 2)) > 1e3)
    if bad.any():
        inverse[bad] = torch.linalg.pinv(matrices[bad], rtol=1e-3)
    return inverse


def _starting(
    deformation: Deformation, points: Tensor, starts: Starts
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, int]:
    """Targets, first guesses and first inverse Jacobians of M searches, and their places among the roots."""
    if isinstance(starts, AllBones):
        turn, offset = deformation.turn.detach(), deformation.offset.detach()
        count = len(turn)
        first = torch.einsum("jba,njb->nja", turn, points[:, None] - offset).flatten(0, 1)
        rows = torch.arange(len(points)).repeat_interleave(count)
        columns = torch.arange(count).repeat(len(points))
        inverse = deformation.blend(first).transpose(1, 2)
        return points[rows], first, inverse, rows, columns, count
    nearest = deformation.nearest
    inside = nearest.lattice.inside(points)
    vertices = nearest.vertices[nearest.lattice.nearest(points), : starts.count].where(inside[:, None], -1)
    rows, columns = (vertices >= 0).nonzero().unbind(1)
    vertex, target = vertices[rows, columns], points[rows]
    inverse = nearest.back[vertex]
    first = deformation.field.coarse[vertex] + (inverse @ (target - nearest.posed[vertex])[..., None]).squeeze(2)
    return target, first, inverse, rows, columns, vertices.shape[1]


def _broyden(deformation: Deformation, target: Tensor, x: Tensor, inverse: Tensor) -> tuple[Tensor, Tensor]:
    """The end (M, 3) of each search and whether it is a root (M,)."""
    result, done = x.clone(), torch.zeros(len(x), dtype=torch.bool)
    active = torch.arange(len(x))
    missed = deformation.forward(x) - target
    for _ in range(_STEPS):
        error = missed.square().sum(dim=1)
        converged, keep = error < CONVERGED**2, (error >= CONVERGED**2) & (error < _DIVERGED**2)
        result[active[converged]], done[active[converged]] = x[converged], True
        if not keep.all():
            active, target, x, missed, inverse = (v[keep] for v in (active, target, x, missed, inverse))
        if not len(active):
            break
        step = -(inverse @ missed[..., None]).squeeze(2)
        x = x + step
        after = deformation.forward(x) - target
        change = (inverse @ (after - missed)[..., None]).squeeze(2)
        row = (step[:, None] @ inverse).squeeze(1)
        scale = (step * change).sum(dim=1, keepdim=True)
        scale = torch.where(scale.abs() < _GUARD, _GUARD, scale)
        inverse = inverse + ((step - change) / scale)[..., None] * row[:, None]
        missed = after
    converged = missed.square().sum(dim=1) < CONVERGED**2
    result[active[converged]], done[active[converged]] = x[converged], True
    return result, done
