from __future__ import annotations

import numpy as np
import pytest
import torch

from handbench.errors import InputError
from handbench.render.see.raster import rasterise
from handbench.render.uv.atlas import Atlas
from handbench.skips import Skips, skipping, tallied


def project(camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    seen = points @ camera.world_to_camera[:, :3].T + camera.world_to_camera[:, 3]
    pixels = seen @ camera.K.T
    return pixels[:, :2] / pixels[:, 2:], seen[:, 2]


def test_a_ball_covers_its_disc(shapes) -> None:
    # seen from distance D on the axis, the outline of a ball of radius r has radius f r / sqrt(D^2 - r^2)
    camera = shapes.camera(200, 160, focal=300.0, eye=(0, 0, 5.0))
    raster = rasterise(shapes.sphere(96, 192), camera, supersample=3)
    radius = 300 / np.sqrt(25 - 1)
    assert raster.alpha.shape == (160, 200) and raster.alpha.dtype == np.float32
    assert raster.alpha.sum() == pytest.approx(np.pi * radius**2, rel=0.005)
    assert raster.alpha.min() == 0 and raster.alpha.max() == 1
    assert np.isin(np.round(raster.alpha * 9), np.arange(10)).all()


def test_samples_project_into_their_pixels(shapes) -> None:
    camera = shapes.camera(96, 80, eye=(2.0, 1.5, 4.0))
    mesh = shapes.torus()
    raster = rasterise(mesh, camera, supersample=2)
    points = np.einsum("sk,skc->sc", raster.barycentric, mesh.vertices[mesh.topology.faces[raster.face]])
    pixels, depth = project(camera, points)
    assert np.array_equal(np.floor(pixels[:, 1]) * 96 + np.floor(pixels[:, 0]), raster.pixel)
    assert np.allclose(depth, raster.depth, atol=1e-4)
    # subsamples are on a regular grid: a quarter and three quarters
    assert np.allclose(np.abs(pixels % 1 - 0.5), 0.25, atol=2e-3)
    # all samples see the front of a closed surface
    towards = camera.centre - points
    assert ((raster.normal * towards).sum(axis=1) > -0.1 * np.linalg.norm(towards, axis=1)).all()
    assert np.allclose(np.linalg.norm(raster.normal, axis=1), 1)


def test_positions_drawn_as_an_attribute_project_to_pixel_centres(shapes) -> None:
    camera = shapes.camera(64, 48)
    mesh = shapes.sphere()
    raster = rasterise(mesh, camera, supersample=3)
    image = raster.attribute(mesh.vertices)
    inside = raster.alpha == 1
    pixels, _ = project(camera, image[inside].astype(np.float64))
    rows, columns = np.nonzero(inside)
    error = np.abs(pixels - np.stack([columns, rows], axis=1) - 0.5)
    assert np.median(error) < 0.01
    assert not image[raster.alpha == 0].any()


def test_a_texture_that_is_linear_in_position_gives_the_position(shapes) -> None:
    camera = shapes.camera(80, 64, focal=60.0, eye=(0.0, 2.0, 1.5))
    mesh = shapes.plane(size=2.0, cells=3)
    atlas = Atlas(mesh.topology, 64)
    raster = rasterise(mesh, camera)
    texture = atlas.scatter(torch.from_numpy(atlas.interpolate(mesh.vertices).T).float())
    image = raster.sample(texture)
    expected = raster.attribute(mesh.vertices)
    assert image.shape == (3, 64, 80)
    inner = raster.mean((np.abs(raster.uv - 0.5) < 0.46).all(axis=1, keepdims=True).astype(float))[..., 0] == 1
    assert inner.sum() > 500
    assert np.allclose(image.permute(1, 2, 0).numpy()[inner], expected[inner], atol=2e-5)
    # at the border of the chart the dilated texture is off by less than a texel, the raw one mixes in black
    ones = torch.from_numpy(atlas.covered).float()[None]
    alpha = torch.from_numpy(raster.alpha)
    assert torch.allclose(raster.sample(atlas.dilate(ones))[0], alpha, atol=1e-6)
    assert (raster.sample(ones)[0] < alpha - 0.01).any()


def test_sampling_is_bilinear(shapes) -> None:
    camera = shapes.camera(32, 24, eye=(0.3, 2.0, 1.5), focal=25.0)
    raster = rasterise(shapes.plane(size=2.0), camera, supersample=2)
    texture = torch.rand(2, 16, 16, generator=torch.Generator().manual_seed(0))
    grid = torch.from_numpy(np.stack([2 * raster.uv[:, 0] - 1, 1 - 2 * raster.uv[:, 1]], axis=-1)).float()
    values = torch.nn.functional.grid_sample(
        texture[None], grid[None, None], mode="bilinear", padding_mode="border", align_corners=False
    )[0, :, 0]
    expected = raster.mean(values.T.double().numpy())
    assert np.allclose(raster.sample(texture).permute(1, 2, 0).numpy(), expected, atol=1e-5)


def test_sampling_is_linear_and_its_gradient_is_the_transpose(shapes) -> None:
    raster = rasterise(shapes.sphere(16, 32), shapes.camera(24, 20, focal=40.0), supersample=2)
    generator = torch.Generator().manual_seed(1)
    a, b = torch.rand(2, 3, 8, 8, generator=generator)
    assert torch.allclose(raster.sample(2 * a - b), 2 * raster.sample(a) - raster.sample(b), atol=1e-6)
    texture, image = a.clone().requires_grad_(), torch.rand(3, 20, 24, generator=generator)
    (gradient,) = torch.autograd.grad((raster.sample(texture) * image).sum(), texture)
    assert float((gradient * b).sum()) == pytest.approx(float((raster.sample(b) * image).sum()), rel=1e-4)


def test_only_the_box_of_the_mesh_is_traced_and_nothing_is_lost(shapes) -> None:
    mesh = shapes.sphere(24, 48)
    centred, aside = (shapes.camera(90, 60, eye=(0, 0, 6.0), target=(t, 0, 0)) for t in (0.0, 1.8))
    assert (
        rasterise(mesh, aside).alpha[:, 0].any() and not rasterise(mesh, centred).alpha[:, 0].any()
    )  # cut by the border
    away = shapes.camera(30, 20, eye=(0, 0, 5.0), target=(0, 0, 10.0))
    behind = rasterise(mesh, away)
    assert not behind.alpha.any() and len(behind.pixel) == 0
    assert not behind.sample(torch.ones(3, 8, 8)).any()
    within = rasterise(mesh, shapes.camera(30, 20, eye=(0, 0, 0.1)))  # the mesh is all around the camera
    assert (within.alpha == 1).all()


def test_pixels_away_from_all_triangles_get_no_rays_and_nothing_is_lost(shapes) -> None:
    for mesh, eye in zip(
        (shapes.torus(), shapes.sphere(3, 4), shapes.plane(1.0)),
        ((0.5, 4.0, 16.0), (0, 0, 9.0), (1.0, 2.0, 1.0)),
        strict=True,
    ):
        camera = shapes.camera(90, 60, eye=eye)
        with tallied() as tally:
            near = rasterise(mesh, camera)
        with skipping(Skips(outside_box=False)):
            whole = rasterise(mesh, camera)
        rays = tally.lines()["camera rays"]
        assert np.array_equal(near.pixel, whole.pixel) and np.array_equal(near.depth, whole.depth)
        assert rays.total == 90 * 60 * 9 and len(near.pixel) <= rays.total - rays.skipped < rays.total


def test_useless_calls_are_refused(shapes) -> None:
    with pytest.raises(InputError, match="supersample 0"):
        rasterise(shapes.sphere(8, 16), shapes.camera(), supersample=0)
    with pytest.raises(InputError, match=r"\(3, 8, 4\)"):
        rasterise(shapes.sphere(8, 16), shapes.camera()).sample(torch.ones(3, 8, 4))
