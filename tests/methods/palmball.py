"""A ball where a posed hand would be: what PALM-Net's drawing asks of a field, in closed form."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import torch
from torch import Tensor

from handbench.lean import open3d
from handbench.methods.palm.reflectance import Material
from handbench.scene import Mesh, Topology

RADIUS = 0.05
FOOT = 5e-4
"""Metres in which the density rises."""


@dataclass(frozen=True, eq=False)
class Ball:
    """A ball about `middle` (3,) of one albedo (3,), roughness and metallic: a posed hand to those who draw it."""

    middle: Tensor
    albedo: Tensor
    roughness: float = 0.5
    metallic: float = 0.0

    model = SimpleNamespace(config=SimpleNamespace(marching=None))

    @property
    def box(self) -> Tensor:
        return torch.stack([self.middle - 1.2 * RADIUS, self.middle + 1.2 * RADIUS]).detach()

    def moved(self, codes: object, shape: Tensor, joints: Tensor, rotation: Tensor, translation: Tensor) -> Ball:
        return replace(self, middle=translation, albedo=torch.sigmoid(codes.appearance))

    def sdf(self, points: Tensor) -> Tensor:
        return (points - self.middle).norm(dim=1) - RADIUS

    def density(self, points: Tensor) -> Tensor:
        sdf = self.sdf(points)
        return (0.5 + 0.5 * sdf.sign() * torch.expm1(-sdf.abs() / FOOT)) / FOOT

    def surface(self, spacing: float) -> SimpleNamespace:
        made = open3d().geometry.TriangleMesh.create_sphere(RADIUS, resolution=60)
        canonical = np.asarray(made.vertices)
        mesh = Mesh(canonical + self.middle.detach().double().numpy(), Topology(np.asarray(made.triangles)))
        return SimpleNamespace(mesh=mesh, canonical=torch.from_numpy(canonical).float())

    def mesh(self, spacing: float) -> Mesh:
        return self.surface(spacing).mesh

    def material(self, x: Tensor) -> Material:
        same = (torch.full((len(x),), value) for value in (self.roughness, self.metallic))
        return Material(self.albedo.expand(len(x), 3), *same)


@dataclass(frozen=True, eq=False)
class March:
    """What a march through the ball finds, sample by sample."""

    ray: Tensor
    weight: Tensor
    point: Tensor
    normal: Tensor
    sdf: Tensor
    towards: Tensor
    ball: Ball
    rays: int

    @property
    def alpha(self) -> Tensor:
        return self.total(torch.ones(len(self.ray), 1))[:, 0]

    def total(self, values: Tensor) -> Tensor:
        return values.new_zeros(self.rays, values.shape[1]).index_add(0, self.ray, self.weight[:, None] * values)

    def material(self, posed: object) -> Material:
        return self.ball.material(self.point)

    def radiance(self, posed: object) -> Tensor:
        return self.total(self.ball.albedo.expand(len(self.ray), 3))


def render(posed: Ball, origins: Tensor, directions: Tensor, marching: object, rng: object, samples: int = 96) -> March:
    """A fine march of the box: midpoints, all rays, nothing skipped."""
    near = (posed.middle.detach() - origins).norm(dim=1) - 1.5 * RADIUS
    step = 3.0 * RADIUS / samples
    away = near[:, None] + step * (torch.arange(samples) + 0.5)
    points = (origins[:, None] + away[..., None] * directions[:, None]).reshape(-1, 3)
    absorbed = step * posed.density(points).reshape(len(origins), samples)
    through = torch.exp(-(torch.cumsum(absorbed, 1) - absorbed))
    weight = (through * -torch.expm1(-absorbed)).flatten()
    ray = torch.arange(len(origins)).repeat_interleave(samples)
    sdf = posed.sdf(points)
    normal = torch.nn.functional.normalize(points - posed.middle, dim=1)
    kept = weight.detach() > 1e-5
    samples_of = (weight[kept], points[kept], normal[kept], sdf[kept], directions[ray[kept]])
    return March(ray[kept], *samples_of, posed, len(origins))
