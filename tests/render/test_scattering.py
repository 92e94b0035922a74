"""Light under the skin: what diffusion keeps, where it goes and where it must not."""

from __future__ import annotations

import numpy as np
import pytest

from handbench.data.openstage.trace.diffusion import PROFILE, diffusion, escaped
from handbench.data.openstage.trace.levels import level, vertex_points
from handbench.data.openstage.trace.pathtrace import PathTracer, TracedSurface
from handbench.hand.openhand import OpenHand, named_pose
from handbench.render.see.posedmesh import PosedMesh
from handbench.scene import Array, Camera, Directional, Environment, Mesh, Topology

SKIN = np.array([3.7, 1.4, 0.7]) * 1e-3
"""Diffuse mean free paths of Jensen's skin 1, metres."""


def grid(columns: int, rows: int, spacing: float, seed: int = 0) -> tuple[Array, Array]:
    """Vertices (columns * rows, 3) of a plane that faces +z, a little uneven inside, and faces."""
    x, y = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
    inside = (x > 0) & (x < columns - 1) & (y > 0) & (y < rows - 1)
    uneven = np.random.default_rng(seed).uniform(-0.2, 0.2, (2, columns, rows)) * inside
    vertices = np.stack([x + uneven[0], y + uneven[1], 0 * x], axis=-1).reshape(-1, 3) * spacing
    i = np.arange(columns * rows).reshape(columns, rows)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    return vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def slab(width: float, thickness: float, spacing: float, centre: tuple[float, float, float] = (0, 0, 0)) -> Mesh:
    """Two planes back to back, open at the rim."""
    count = round(width / spacing) + 1
    front, faces = grid(count, count, spacing)
    front -= [width / 2, width / 2, -thickness / 2]
    back = front * [1, 1, -1]
    faces = np.concatenate([faces, faces[:, ::-1] + len(front)])
    vertices = np.concatenate([front, back]) + centre
    return Mesh(vertices, Topology(faces, np.full((len(vertices), 2), 0.5), faces))


def joined(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = np.concatenate([mesh.topology.faces + start for mesh, start in zip(meshes, starts, strict=False)])
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    return Mesh(vertices, Topology(faces, np.full((len(vertices), 2), 0.5), faces))


def front(metres: float, size: int = 24) -> Camera:
    """A far camera on +z that sees so many metres."""
    K = np.array([[size / metres, 0, size / 2], [0, size / metres, size / 2], [0, 0, 1]])
    return Camera("front", size, size, K, np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 1.0]]))


def even(mesh: Mesh, albedo: Array, path: Array | None, specular: float = 0.0) -> TracedSurface:
    texture = np.broadcast_to(albedo, (2, 2, 3))
    return TracedSurface(mesh, texture, np.full((2, 2), 0.45), specular, mean_free_path=path)


def sun(*direction: float) -> Directional:
    return Directional(np.array(direction) / np.linalg.norm(direction), np.ones(3))


@pytest.mark.parametrize("channel", range(3))
def test_light_of_a_spot_spreads_by_the_profile_and_none_is_lost(channel: int) -> None:
    """How much of a spot's light leaves within a radius, against the integral of the profile over a disc."""
    vertices, faces = grid(121, 121, 0.65e-3)
    posed = PosedMesh(Mesh(vertices, Topology(faces, vertices[:, :2], faces)))
    points = vertex_points(vertices, posed.normals, faces)
    path = np.broadcast_to(SKIN, vertices.shape)
    spread = diffusion(points, path, np.full_like(path, 0.5), posed.rays)
    away = np.linalg.norm(vertices - vertices[len(vertices) // 2], axis=1)
    spot = away < 2e-3
    leaves = spread.apply(channel, spot[:, None].astype(np.float32))[:, 0] * points.areas
    arrived = points.areas[spot].sum()
    assert leaves.sum() == pytest.approx(arrived, rel=0.04)
    scale = SKIN[channel] / PROFILE
    rng = np.random.default_rng(0)  # the disc's light, moved by distances drawn from the profile
    lobe = np.where(rng.random(200_000) < 0.25, scale, 3 * scale)
    moved = rng.exponential(lobe) * np.exp(2j * np.pi * rng.random(len(lobe)))
    landed = np.abs(np.sqrt(arrived / np.pi) * np.sqrt(rng.random(len(lobe))) + moved)
    for radius in (1e-3, 2e-3, 4e-3, 8e-3):
        assert leaves[away < radius].sum() / arrived == pytest.approx((landed < radius).mean(), abs=0.06)


def test_what_escapes_is_the_profile_beyond_a_radius() -> None:
    radius = np.linspace(1e-7, 0.1, 2_000_000)
    scale = SKIN[1] / PROFILE
    profile = (np.exp(-radius / scale) + np.exp(-radius / (3 * scale))) / (8 * np.pi * scale * radius)
    beyond = np.trapezoid((2 * np.pi * radius * profile)[radius > 1e-3], radius[radius > 1e-3])
    assert escaped(SKIN[1:2], 1e-3)[0] == pytest.approx(beyond, rel=1e-3)


@pytest.mark.parametrize("specular", [0.0, 0.42])
def test_a_white_hand_under_an_even_sky_returns_what_it_receives(specular: float) -> None:
    hand = OpenHand.load()
    mesh = hand.mesh(hand.sample_identity(np.random.default_rng(0)), named_pose("rest"), 1)
    K = np.array([[200.0, 0, 24], [0, 200.0, 32], [0, 0, 1]])
    camera = Camera("dorsal", 48, 64, K, np.array([[-1.0, 0, 0, 0], [0, -1, 0, 0.07], [0, 0, 1, 1.0]]))
    surface = even(mesh, np.ones(3), SKIN, specular)
    tracer = PathTracer()
    image = tracer.render(surface, camera, [Environment("white", np.ones((8, 16, 3)))], 192, 0)[0]
    inside = tracer.gbuffer(surface, camera, 16).alpha == 1
    assert inside.sum() > 300
    assert image[inside].mean(axis=0) == pytest.approx(np.ones(3), abs=0.02)
    assert np.median(np.abs(image[inside] - 1)) < 0.02


def test_thin_flesh_lit_from_behind_glows_red() -> None:
    """3 mm of Jensen's skin: (0.29, 0.13, 0.03) by a random walk (benchmarks/scattering.py, radiance over 3 / pi)."""
    mesh, albedo = slab(0.03, 3e-3, 1e-3), np.array([0.549, 0.300, 0.168])
    image = PathTracer().render(even(mesh, albedo, SKIN), front(0.02), [sun(0, 0, -1)], 16, 0)[0]
    red, green, blue = image[8:16, 8:16].mean(axis=(0, 1)) * 3
    assert red == pytest.approx(0.29, rel=0.25) and green == pytest.approx(0.133, rel=0.4)
    assert red > 2 * green > 4 * blue
    opaque = PathTracer().render(even(mesh, albedo, None), front(0.02), [sun(0, 0, -1)], 16, 0)[0]
    assert opaque.max() == 0


def test_no_light_crosses_a_gap_between_two_things_that_touch() -> None:
    """The lower of two slabs, 0.1 mm apart, is in the upper one's shadow."""
    upper, lower = slab(0.03, 6e-3, 1e-3, (0, 0, 3.05e-3)), slab(0.02, 6e-3, 1e-3, (0, 0, -3.05e-3))
    albedo = np.full(3, 0.5)
    below = Camera("below", 16, 16, front(0.016, 16).K, np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1.0]]))
    light = [sun(0, 0, 1)]
    whole = slab(0.03, 6e-3, 1e-3)
    through = PathTracer().render(even(whole, albedo, SKIN), below, light, 16, 0, max_depth=2)[0]
    behind = PathTracer().render(even(joined(upper, lower), albedo, SKIN), below, light, 16, 0, max_depth=2)[0]
    assert through[4:12, 4:12, 0].min() > 0.01
    assert behind[4:12, 4:12].max() < 3e-3 * through[..., 0].max()


def test_polish_neither_takes_nor_gives_light_under_the_surface() -> None:
    """A plane whose left half does not scatter, lit on either side of the border only by what is seen there."""
    vertices, faces = grid(41, 41, 0.5e-3)
    mesh = Mesh(vertices - [0.01, 0.01, 0], Topology(faces, vertices[:, :2] / 0.02, faces))
    path = np.zeros((64, 64, 3))
    path[:, 32:] = SKIN
    surface = TracedSurface(mesh, np.full((2, 2, 3), 0.5), np.full((2, 2), 0.4), 0.0, mean_free_path=path)
    matte = TracedSurface(mesh, surface.albedo, surface.roughness, 0.0)
    lamp = [sun(0.3, 0, 1)]
    image, plain = (PathTracer().render(each, front(0.016), lamp, 16, 0)[0] for each in (surface, matte))
    np.testing.assert_allclose(image[:, :11], plain[:, :11], rtol=1e-5)
    np.testing.assert_allclose(image, plain, rtol=0.02)  # even light stays even up to the border


def test_no_mean_free_path_is_the_surface_model() -> None:
    mesh = slab(0.02, 4e-3, 1e-3)
    lights = [sun(0.5, 0.2, 1), Environment("sky", np.random.default_rng(0).uniform(0, 2, (8, 16, 3)))]
    still, switched = (
        PathTracer().render(even(mesh, np.full(3, 0.5), path, 0.42), front(0.016), lights, 48, 0)
        for path in (np.zeros(3), None)
    )
    np.testing.assert_array_equal(still, switched)


def test_clusters_keep_areas_means_and_sides() -> None:
    mesh = PosedMesh(slab(0.02, 0.2e-3, 0.5e-3))
    points = vertex_points(mesh.vertices, mesh.normals, mesh.topology.faces)
    coarse = level(points, 2e-3)
    assert len(coarse.middle) < len(points.areas) / 6
    assert coarse.points.areas.sum() == pytest.approx(points.areas.sum(), rel=1e-6)
    side = np.sign(mesh.vertices[:, 2])
    np.testing.assert_allclose(np.abs(coarse.gather @ side), 1, rtol=1e-6)
    np.testing.assert_allclose(coarse.spread @ (coarse.gather @ side), side, rtol=1e-6)
    np.testing.assert_allclose(coarse.spread @ np.ones(len(coarse.middle)), 1, rtol=1e-6)
