"""Rays at every scale and place, and shadow rays that bend over the surface: no acne, no leaks.

Oracles: the sphere, the plane and two capsules in closed form, and a float64 test of every ray with every triangle.
"""

from __future__ import annotations

import numpy as np
import pytest

from handbench.light.stage import stage_directions
from handbench.render.see.rays import RayScene
from handbench.render.see.visibility import visibility
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.surface import face_normals, mesh_normals
from handbench.scene import Array, Mesh
from handbench.skips import NONE, skipping

# a hand of 0.2 mm beside the origin, one of 0.2 m, and both of 0.2 mm and 200 m far away
PLACES = pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (1e-3, 0.0), (1e3, 0.0), (1e-3, 1e4), (1e3, 1e4)])


def moved(mesh: Mesh, scale: float, offset: float) -> Mesh:
    return Mesh(mesh.vertices * scale + np.array([1.0, -0.6, 0.3]) * offset, mesh.topology)


def smooth_normals(mesh: Mesh, atlas: Atlas) -> Array:
    normal = atlas.interpolate(mesh_normals(mesh))
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


@PLACES
def test_a_scene_answers_in_its_own_units_wherever_it_is(shapes, scale: float, offset: float) -> None:
    mesh = moved(shapes.sphere(64, 128), scale, offset)
    scene = RayScene(mesh.vertices, mesh.topology.faces)
    middle = np.array([1.0, -0.6, 0.3]) * offset
    hits = scene.cast(middle + scale * np.array([[0, 0, 5.0], [3, 3, 5.0]]), np.array([[0.0, 0.0, -scale]]))
    assert hits.hit.tolist() == [True, False]
    assert hits.distance[0] == pytest.approx(4.0, rel=1e-4)
    assert scene.epsilon == pytest.approx(2e-5 * scale, rel=1e-6)
    assert scene.radius == pytest.approx(np.sqrt(3) * scale, rel=1e-3)
    packed = np.array([[0, 0, 5, 0, 0, -1], [0, 0, 5, 0, 0, 1]], dtype=np.float32) * np.float32(scale)
    assert scene.distances(packed) == pytest.approx([4.0, np.inf], rel=1e-4)


@PLACES
def test_a_sphere_is_lit_where_its_normal_faces_the_light(shapes, scale: float, offset: float) -> None:
    rows = 40
    mesh = moved(shapes.sphere(rows, 2 * rows, radius=0.1), scale, offset)
    atlas = Atlas(mesh.topology, 48)
    lights = stage_directions(24)
    cosine = lights @ smooth_normals(mesh, atlas).T
    with skipping(NONE):  # every pair is traced
        seen = visibility(mesh, atlas, lights)
        lamps = visibility(mesh, atlas, lights[:0], lights * 100.0 * scale + np.array([1.0, -0.6, 0.3]) * offset)
    # starts on the smooth sphere look over the flat triangles: sqrt(2 sagitta / radius), here 4.5 degrees
    band = np.sqrt(2 * (1 - np.cos(np.pi / rows)))
    for answer in (seen, lamps):
        assert answer[cosine > 2e-3].all()
        assert not answer[cosine < -band].any()
    assert seen[cosine > 0].all()


@PLACES
@pytest.mark.parametrize("degrees", [0.1, 0.5, 2.0, 30.0, 90.0])
def test_a_plane_is_lit_from_above_at_any_angle_and_never_from_below(
    shapes, scale: float, offset: float, degrees: float
) -> None:
    mesh = moved(shapes.plane(0.2, cells=7), scale, offset)
    atlas = Atlas(mesh.topology, 40)
    turn = np.linspace(0.0, 2 * np.pi, 12, endpoint=False) + 0.1
    up, along = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    above = np.stack([along * np.sin(turn), np.full_like(turn, up), along * np.cos(turn)], axis=1)
    below = above * [1, -1, 1]
    assert visibility(mesh, atlas, above).all()
    assert not visibility(mesh, atlas, below).any()
    with skipping(NONE):
        assert visibility(mesh, atlas, above).all()
        # traced, the light from below gets in by the border alone: within epsilon / tan(angle) of it
        leaked = visibility(mesh, atlas, below)
    place = (atlas.interpolate(mesh.vertices) - mesh.vertices.min(axis=0))[:, [0, 2]]
    inside = np.minimum(place, 0.2 * scale - place).min(axis=1)
    assert not leaked[:, inside > 2.1e-6 * scale / np.tan(np.radians(degrees)) + 1e-7 * scale].any()


RADIUS, LENGTH = 0.1, 0.3


def capsule(shapes, x: float, box: tuple[float, float, float, float]) -> Mesh:
    """A finger along y: LENGTH between the middles of its ends; vertices at x +- RADIUS."""
    ball = shapes.sphere(20, 24, box=box)
    way = np.arccos(np.clip(ball.vertices[:, 1], -1, 1)) / np.pi  # from the upper tip (0) to the lower (1)
    upper = np.where(way < 0.5, 1.0, -1.0)
    angle = np.clip(np.minimum(way, 1 - way) / 0.4, 0.0, 1.0) * np.pi / 2
    middle = np.where(angle < np.pi / 2, upper, (0.5 - way) / 0.1) * LENGTH / 2
    around = ball.vertices[:, [0, 2]] / np.maximum(np.hypot(*ball.vertices[:, [0, 2]].T), 1e-9)[:, None]
    across = RADIUS * np.sin(angle)[:, None] * around
    y = middle + upper * RADIUS * np.cos(angle)
    return Mesh(np.stack([x + across[:, 0], y, across[:, 1]], axis=1), ball.topology)


def fingers(shapes, gap: float) -> Mesh:
    left = capsule(shapes, -RADIUS - gap / 2, (0.02, 0.02, 0.48, 0.98))
    return shapes.join(left, capsule(shapes, RADIUS + gap / 2, (0.52, 0.02, 0.98, 0.98)))


def brute_force(mesh: Mesh, atlas: Atlas, directions: Array) -> Array:
    """Shadows (L, N) in float64: every ray with every triangle, from starts lifted to the smooth surface."""
    corners = mesh.topology.faces[atlas.face]
    a, b, c = (mesh.vertices[mesh.topology.faces[:, k]] for k in range(3))
    start = atlas.interpolate(mesh.vertices)
    lifted = np.zeros_like(start)
    for k in range(3):  # the mean of the projections onto the tangent planes of the vertices, if they are above
        vertex, normal = mesh.vertices[corners[:, k]], mesh_normals(mesh)[corners[:, k]]
        height = np.minimum(((start - vertex) * normal).sum(axis=1, keepdims=True), 0.0)
        lifted += atlas.barycentric[:, k : k + 1] * (start - height * normal)
    extent = np.ptp(mesh.vertices, axis=0).max()
    lifted += 1e-5 * extent * face_normals(mesh.vertices, mesh.topology.faces)[atlas.face]
    return np.stack([~_any_hit(lifted, direction, a, b - a, c - a) for direction in directions])


def _any_hit(origins: Array, direction: Array, a: Array, ab: Array, ac: Array) -> Array:
    """Whether rays (N, 3) along one direction hit one of the triangles (F, 3): Möller and Trumbore's test."""
    across = np.cross(direction, ac)
    area = (ab * across).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (origins @ across.T - (a * across).sum(axis=1)) / area
        # all three are determinants that are linear in the origin
        v_axis, t_axis = np.cross(ab, direction), np.cross(ab, ac)
        v = (origins @ v_axis.T - (a * v_axis).sum(axis=1)) / area
        t = (origins @ t_axis.T - (a * t_axis).sum(axis=1)) / area
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return hit.any(axis=1)


@pytest.fixture(scope="module", params=[0.0, -0.004, 0.002], ids=["touching", "pressed together", "apart"])
def shaded(request, shapes) -> tuple[Mesh, Atlas, Array, Array]:
    """Two fingers, their atlas, lights and the shadows of these."""
    mesh = fingers(shapes, request.param)
    atlas = Atlas(mesh.topology, 40)
    lights = np.concatenate([stage_directions(7), [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]])
    return mesh, atlas, lights, brute_force(mesh, atlas, lights)


@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (1e-3, 1e4), (1e3, 1e4)])
def test_touching_fingers_shade_each_other_as_in_float64(shaded, scale: float, offset: float) -> None:
    here, atlas, lights, truth = shaded
    mesh = moved(here, scale, offset)
    cosine = lights @ smooth_normals(here, atlas).T
    seen = visibility(mesh, atlas, lights)
    assert 0.5 < truth[cosine > 0].mean() < 0.95
    assert (seen != truth)[cosine > 0].mean() < 1e-3


@pytest.mark.parametrize("gap", [0.0, -0.004])
def test_no_light_leaks_through_the_contact_of_two_fingers(shapes, gap: float) -> None:
    # against smooth capsules, which the triangles follow to 2 %, and all along the line of contact
    mesh = fingers(shapes, gap)
    atlas = Atlas(mesh.topology, 64)
    position, normal = atlas.interpolate(mesh.vertices), smooth_normals(mesh, atlas)
    lights = stage_directions(30)
    seen, cosine = visibility(mesh, atlas, lights), lights @ normal.T
    other = np.stack([-np.sign(position[:, 0]) * (RADIUS + gap / 2), 0 * position[:, 0], 0 * position[:, 0]], axis=1)
    along = np.linspace(0.0, 0.6, 60)[:, None, None]
    clearance = np.empty(seen.shape)
    for row, light in enumerate(lights):
        ray = position + along * light - other
        ray[..., 1] -= np.clip(ray[..., 1], -LENGTH / 2, LENGTH / 2)
        clearance[row] = np.linalg.norm(ray, axis=-1).min(axis=0)
    sure = cosine > 0.05
    assert seen[sure & (clearance > 1.02 * RADIUS)].all(), "acne"
    assert not seen[clearance < 0.97 * RADIUS].any(), "a leak"
    contact = (np.abs(position[:, 0]) < 1.5e-3) & (np.abs(position[:, 1]) < LENGTH / 2)
    across = np.abs(lights[:, 0]) > 0.5
    assert contact.sum() > 10
    assert not seen[np.ix_(across, contact)].any()
