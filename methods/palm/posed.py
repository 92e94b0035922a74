"""A person's hand in a pose, and what rays see of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from handbench.hand.canonical import Deformation, Roots, attached, canonicalise
from handbench.hand.handmodel import vector
from handbench.hand.skinning import rotation_matrix
from handbench.render.volume import Intervals, Marching, Shell, refined, through, weights
from handbench.scene import Mesh
from handbench.skips import note, skips

from .model import LatentCodes, PalmModel
from .reflectance import Material
from .surface import FieldSurface, extracted

FAR = 1.0
"""Metres that a signed distance has where no canonical place is known."""


class PosedHand:
    """A hand of a person's codes and shape (S,) in a pose: joints (J, 3), rotation and translation (3,) as in `Pose`.

    Whatever of these requires a gradient gets it: roots by the implicit function theorem. Where on rays the surface is
    looked for does not depend on codes, and is found once: `moved` keeps it for small changes.
    """

    def __init__(
        self, model: PalmModel, codes: LatentCodes, shape: Tensor, joints: Tensor, rotation: Tensor, translation: Tensor
    ) -> None:
        self.model, self.codes = model, codes
        self.shape, self.joints = shape, joints
        self.turn = rotation_matrix(vector("rotation", rotation, (3,), torch.float32))
        self.translation = vector("translation", translation, (3,), torch.float32)
        self.deformation = Deformation(model.around(shape), shape, joints)
        self.conditions = model.conditions(codes, shape, joints)

    @cached_property
    @torch.no_grad()
    def shell(self) -> Shell:
        """Where rays look for the surface, in the hand frame."""
        hand, level = self.model.hand, self.deformation.field.level
        skin = hand.subdivide(hand.skin(self.shape, self.joints), level)
        return Shell.around(skin.numpy(), hand.topology(level).faces, self.model.config.reach)

    def moved(self, **changed: Any) -> PosedHand:
        """The same with other `codes`, `shape`, `joints`, `rotation` or `translation`, a few millimetres away."""
        other = object.__new__(PosedHand)
        other.model, other.shell = self.model, self.shell
        other.codes = changed.get("codes", self.codes)
        other.shape, other.joints = changed.get("shape", self.shape), changed.get("joints", self.joints)
        other.turn, other.translation = self.turn, self.translation
        if "rotation" in changed:
            other.turn = rotation_matrix(vector("rotation", changed["rotation"], (3,), torch.float32))
        if "translation" in changed:
            other.translation = vector("translation", changed["translation"], (3,), torch.float32)
        other.deformation = self.deformation
        if "shape" in changed or "joints" in changed:
            other.deformation = Deformation(self.deformation.field, other.shape, other.joints)
            other.deformation.nearest = self.deformation.nearest
        other.conditions = self.model.conditions(other.codes, other.shape, other.joints)
        return other

    # -- places -----------------------------------------------------------------------------------------------------

    def local(self, points: Tensor) -> Tensor:
        """Points (N, 3) of the world in the hand frame."""
        return (points - self.translation) @ self.turn

    def placed(self, points: Tensor) -> Tensor:
        """Points (N, 3) of the hand frame in the world."""
        return points @ self.turn.T + self.translation

    @property
    def box(self) -> Tensor:
        """Corners (2, 3) of a box in the world outside which there is nothing."""
        low, high = self.shell.box
        corners = torch.cartesian_prod(*torch.stack([low, high], dim=1))
        with torch.no_grad():
            corners = self.placed(corners)
        return torch.stack([corners.amin(dim=0), corners.amax(dim=0)])

    @torch.no_grad()
    def roots(self, local: Tensor) -> tuple[Tensor, Tensor]:
        """Canonical places (N, 3) of points (N, 3) of the hand frame, and whether there is one (N,).

        Of several the one with the least signed distance: the union of all sheets of a folded hand.
        """
        found = canonicalise(self.deformation, local, self.model.config.starts)
        return _union(found, self._distances(found)), found.valid.any(dim=1)

    def _distances(self, found: Roots) -> Tensor:
        """Signed distances (N, K) of candidates, infinite where there is none, 0 where there is one only."""
        distances = torch.zeros(found.valid.shape).where(found.valid, torch.inf)
        several = found.valid & (found.valid.sum(dim=1, keepdim=True) > 1)
        if several.any():
            distances[several] = self.model.geometry(found.x[several], self.conditions).sdf
        return distances

    @torch.no_grad()
    def sdf(self, points: Tensor) -> Tensor:
        """Signed distances (N,) in canonical metres of points (N, 3) in the world; `FAR` without a canonical place."""
        return self.local_sdf(self.local(points))

    @torch.no_grad()
    def local_sdf(self, local: Tensor) -> Tensor:
        """The same of points (N, 3) of the hand frame."""
        x, there = self.roots(local)
        found = torch.full((len(local),), FAR)
        found[there] = self.model.geometry(x[there], self.conditions).sdf
        return found

    @torch.no_grad()
    def density(self, points: Tensor) -> Tensor:
        """Density (N,) in 1/m at points (N, 3) in the world."""
        return self.model.density(self.sdf(points))

    def normals(self, x: Tensor, gradient: Tensor) -> Tensor:
        """Unit normals (N, 3) in the world of gradients (N, 3) of the signed distance at canonical places (N, 3)."""
        if self.model.config.normals == "rotation":
            turned = (self.deformation.blend(x) @ gradient[..., None]).squeeze(2)
        else:
            jacobian = self.deformation.jacobian(x)
            # J^-T g up to its length, by cofactors: no inverse is needed, and none is missed in a fold
            a, b, c = jacobian.unbind(1)
            cofactors = torch.stack(
                [torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)], dim=1
            )
            turned = (cofactors @ gradient[..., None]).squeeze(2)
        return torch.nn.functional.normalize(turned @ self.turn.T, dim=1, eps=1e-9)

    def material(self, x: Tensor) -> Material:
        """What the hand is made of at canonical places (N, 3)."""
        return self.model.material(x, self.model.geometry(x, self.conditions).feature, self.conditions)

    def surface(self, spacing: float = 2e-3) -> FieldSurface:
        """The surface as a mesh in the world, see `extracted`."""
        return extracted(self, spacing)

    def mesh(self, spacing: float = 2e-3) -> Mesh:
        return self.surface(spacing).mesh


def _union(found: Roots, distances: Tensor) -> Tensor:
    best = distances.argmin(dim=1)
    return found.x[torch.arange(len(best)), best]


@dataclass(frozen=True, eq=False)
class Rendering:
    """What R rays see: P samples with their weights, in the order of rays and front to back.

    ray (P,), weight (P,); point (P, 3) in the world, towards (P, 3) the ray's direction; x (P, 3) canonical; sdf (P,)
    metres, feature (P, 1 + F), gradient (P, 3) of the distance in canonical space; normal (P, 3) unit, in the world.
    alpha (R,) what rays are stopped by, depth (R,) the mean distance of that, 0 where nothing is.
    """

    ray: Tensor
    weight: Tensor
    point: Tensor
    x: Tensor
    sdf: Tensor
    feature: Tensor
    gradient: Tensor
    normal: Tensor
    towards: Tensor
    alpha: Tensor
    depth: Tensor

    @property
    def rays(self) -> int:
        return len(self.alpha)

    def total(self, values: Tensor) -> Tensor:
        """Sums (R, C) over each ray of values (P, C) by weight."""
        weighed = self.weight[:, None] * values
        return weighed.new_zeros(self.rays, values.shape[1]).index_add(0, self.ray, weighed)

    def material(self, posed: PosedHand) -> Material:
        """What the samples are made of."""
        return posed.model.material(self.x, self.feature, posed.conditions)

    def radiance(self, posed: PosedHand) -> Tensor:
        """The picture (R, 3) of f_rf, premultiplied."""
        along = (self.towards * self.normal).sum(dim=1, keepdim=True)
        reflected = self.towards - 2.0 * along * self.normal
        colour = posed.model.radiance(self.x, self.feature, reflected, self.normal, posed.conditions)
        return self.total(colour)


def render(
    posed: PosedHand,
    origins: Tensor,
    directions: Tensor,
    marching: Marching | None = None,
    rng: np.random.Generator | None = None,
) -> Rendering:
    """March rays with origins (R, 3) and unit directions (R, 3) in the world through a posed hand.

    With an rng samples are random in their intervals. With `Skips.weightless` samples of less weight than the
    configuration's `least_weight` are left out of `Rendering`'s samples; alpha and depth keep them.
    """
    model = posed.model
    with torch.no_grad():
        local, towards = posed.local(origins), directions @ posed.turn
        intervals = through(posed.shell, local, towards, marching or model.config.marching, rng)
        if model.config.refine:
            points = local[intervals.ray, None] + intervals.middle[..., None] * towards[intervals.ray, None]
            sdf = posed.local_sdf(points.reshape(-1, 3)).view(intervals.middle.shape)
            share = weights(model.density(sdf), intervals.length)
            intervals = refined(intervals, share, model.config.refine, rng)
    return _gathered(posed, intervals, origins, directions)


def _gathered(posed: PosedHand, intervals: Intervals, origins: Tensor, directions: Tensor) -> Rendering:
    model = posed.model
    ray = intervals.ray[:, None].expand_as(intervals.middle).reshape(-1)
    point = origins[ray] + intervals.middle.reshape(-1, 1) * directions[ray]
    local = posed.local(point)
    x, there = posed.roots(local.detach())
    if local.requires_grad or posed.deformation.table.requires_grad:
        x = torch.zeros_like(x).index_put((there.nonzero()[:, 0],), attached(posed.deformation, local[there], x[there]))
    near = model.geometry(x[there], posed.conditions)
    sdf = torch.full((len(x),), FAR).index_put((there.nonzero()[:, 0],), near.sdf)
    share = weights(model.density(sdf).view(intervals.middle.shape), intervals.length)
    weight = share.reshape(-1)
    keep = there & (weight.detach() > model.config.least_weight) if skips().weightless else there
    note("volume samples", len(keep), int(len(keep) - keep.sum()))
    found = model.geometry(x[keep], posed.conditions, gradient=True)
    assert found.gradient is not None
    alpha = torch.zeros(intervals.total).index_add(0, intervals.ray, share.sum(dim=1))
    along = torch.zeros(intervals.total).index_add(0, intervals.ray, (share * intervals.middle).sum(dim=1))
    return Rendering(
        ray=ray[keep],
        weight=weight[keep],
        point=point[keep],
        x=x[keep],
        sdf=found.sdf,
        feature=found.feature,
        gradient=found.gradient,
        normal=posed.normals(x[keep], found.gradient),
        towards=directions[ray[keep]],
        alpha=alpha,
        depth=along / alpha.clamp_min(1e-6),
    )
