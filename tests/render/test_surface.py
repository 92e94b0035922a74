from __future__ import annotations

import numpy as np
import pytest
import torch

from handbench.render.uv.atlas import Atlas
from handbench.render.uv.surface import Relief, surface_maps, vertex_normals


def refine(position: torch.Tensor, normal: torch.Tensor, displacement: torch.Tensor, atlas: Atlas) -> torch.Tensor:
    """Maps to maps: (3, R, R) twice and (..., 1, R, R) to (..., 3, R, R)."""
    relief = Relief(atlas.gather(position), atlas.gather(normal), atlas)
    return atlas.scatter(relief.refined(atlas.gather(displacement)))


def angle(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Degrees between unit vectors along axis -2."""
    return torch.rad2deg(2 * torch.asin(((a - b).norm(dim=-2) / 2).clamp(max=1)))


def test_smooth_normals_of_a_sphere_and_a_torus(shapes) -> None:
    ball = shapes.sphere(32, 64, radius=0.3, centre=(1, 2, 3))
    normals = vertex_normals(ball.vertices, ball.topology.faces)
    assert np.allclose(normals, (ball.vertices - [1, 2, 3]) / 0.3, atol=2e-3)
    ring = shapes.torus(48, 96, ring=1.0, tube=0.4)
    normals = vertex_normals(ring.vertices, ring.topology.faces)
    axis = ring.vertices * [1, 0, 1] / np.linalg.norm(ring.vertices * [1, 0, 1], axis=1, keepdims=True)
    assert np.allclose(normals, (ring.vertices - axis) / 0.4, atol=2e-3)


def test_normals_do_not_depend_on_the_cut_of_the_quads() -> None:
    # a box corner: each face counts once, however its square is cut in triangles
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 0, 1], [0, 1, 1]], dtype=float)
    cut = [[0, 2, 4], [0, 4, 1], [0, 1, 5], [0, 5, 3], [0, 3, 2], [3, 6, 2]]
    assert np.allclose(vertex_normals(vertices, np.array(cut))[0], -np.ones(3) / np.sqrt(3))


def test_surface_maps_lie_on_the_surface(shapes) -> None:
    mesh = shapes.sphere(48, 96, radius=0.1)
    atlas = Atlas(mesh.topology, 64)
    maps = surface_maps(mesh, atlas)
    position, normal = atlas.gather(maps.position), atlas.gather(maps.normal)
    assert torch.allclose(position.norm(dim=0), torch.tensor(0.1), atol=3e-4)  # the sagitta of a facet
    assert torch.allclose(normal.norm(dim=0), torch.tensor(1.0), atol=1e-6)
    assert torch.allclose(position / 0.1, normal, atol=3e-3)
    assert not maps.position[:, ~maps.covered].any() and not maps.normal[:, ~maps.covered].any()


@pytest.mark.parametrize("name", ["sphere", "torus"])
def test_no_displacement_returns_the_normal_itself(shapes, name: str) -> None:
    mesh = getattr(shapes, name)()
    atlas = Atlas(mesh.topology, 64)
    maps = surface_maps(mesh, atlas)
    refined = refine(maps.position, maps.normal, torch.zeros(1, 64, 64), atlas)
    assert torch.allclose(refined, maps.normal, atol=1e-6)


def test_a_parallel_surface_keeps_its_normals(shapes) -> None:
    mesh = shapes.sphere(radius=0.01)
    atlas = Atlas(mesh.topology, 64)
    maps = surface_maps(mesh, atlas)
    for shift in (0.003, -0.003):
        assert torch.allclose(
            refine(maps.position, maps.normal, torch.full((1, 64, 64), shift), atlas), maps.normal, atol=1e-6
        )


@pytest.mark.parametrize("turn", [1, -1])
def test_waves_on_a_plane(shapes, turn: int) -> None:
    box = (0.05, 0.05, 0.95, 0.95) if turn == 1 else (0.95, 0.05, 0.05, 0.95)  # mirrored UVs
    mesh = shapes.plane(size=1.0, cells=32, box=box)
    atlas = Atlas(mesh.topology, 128)
    maps = surface_maps(mesh, atlas)
    assert (maps.normal[1][maps.covered] > 0.999).all()
    x, _, z = maps.position
    delta = 0.01 * torch.sin(9 * x + 5 * z)
    slope = 0.01 * torch.cos(9 * x + 5 * z)
    expected = torch.nn.functional.normalize(torch.stack([-9 * slope, torch.ones_like(x), -5 * slope]), dim=0)
    off = angle(atlas.gather(refine(maps.position, maps.normal, delta[None], atlas)), atlas.gather(expected))
    assert off.mean() < 0.02 and off.max() < 0.25  # degrees; the worst are one-sided at the border


def test_bumps_on_a_sphere(shapes) -> None:
    radius = 0.02
    mesh = shapes.sphere(128, 256, radius=radius)
    atlas = Atlas(mesh.topology, 192)
    maps = surface_maps(mesh, atlas)
    n = maps.normal
    # δ = a sin(k y / r): 3 mm on a 2 cm ball, so the change of area under the displacement matters
    a, k = 0.003, 4.0
    delta = a * torch.sin(k * n[1])
    gradient = a * k * torch.cos(k * n[1]) / radius  # δ along the meridian is this times the tangential part of y
    y = torch.tensor([0.0, 1.0, 0.0])[:, None, None]
    tangential = (y - n[1] * n) * gradient
    expected = torch.nn.functional.normalize(n - tangential * radius / (radius + delta), dim=0)
    refined = refine(maps.position, n, delta[None], atlas)
    away = atlas.gather((n[1].abs() < 0.95)[None].float())[0] > 0  # the poles are singular points of the UVs
    off = angle(atlas.gather(refined), atlas.gather(expected))[away]
    assert off.mean() < 0.05 and off.quantile(0.99) < 0.5
    # without the displacement's change of area it would be degrees off
    naive = torch.nn.functional.normalize(n - tangential, dim=0)
    assert angle(atlas.gather(naive), atlas.gather(expected))[away].mean() > 1


def test_charts_do_not_leak_into_each_other(shapes) -> None:
    mesh = shapes.join(shapes.plane(box=(0.0, 0.0, 0.5, 1.0)), shapes.plane(height=1.0, box=(0.5, 0.0, 1.0, 1.0)))
    atlas = Atlas(mesh.topology, 16)
    maps = surface_maps(mesh, atlas)
    delta = torch.zeros(1, 16, 16)
    delta[:, :, 8:] = 0.1
    assert torch.allclose(refine(maps.position, maps.normal, delta, atlas), maps.normal, atol=1e-6)


def test_batches_are_refined_one_by_one_and_differentiably(shapes) -> None:
    mesh = shapes.sphere(16, 32, radius=0.02)
    atlas = Atlas(mesh.topology, 12)
    maps = surface_maps(mesh, atlas)
    x, n = maps.position.double(), maps.normal.double()
    delta = 0.002 * torch.rand(2, 1, 12, 12, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    both = refine(x, n, delta, atlas)
    assert both.shape == (2, 3, 12, 12)
    assert torch.allclose(both[1], refine(x, n, delta[1], atlas))
    assert torch.allclose(atlas.gather(both).norm(dim=-2), torch.tensor(1.0, dtype=torch.float64))
    assert torch.autograd.gradcheck(lambda d: refine(x, n, d, atlas), delta[0].requires_grad_(), eps=1e-8, atol=1e-4)


def test_folds_stay_finite(shapes) -> None:
    mesh = shapes.sphere(16, 32, radius=0.002)  # displacement beyond the radius of curvature
    atlas = Atlas(mesh.topology, 32)
    maps = surface_maps(mesh, atlas)
    delta = (torch.rand(1, 32, 32) * 0.006 - 0.003).requires_grad_()
    refined = refine(maps.position, maps.normal, delta, atlas)
    assert refined.isfinite().all()
    assert torch.autograd.grad(refined.sum(), delta)[0].isfinite().all()
