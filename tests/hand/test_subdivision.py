"""Catmull–Clark against a tiny readable implementation, and its properties; UVs."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from handbench.hand.openhand import OpenHand
from handbench.hand.subdivision import catmull_clark, linear_step

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
CUBE_QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])


@pytest.fixture(scope="module")
def hand() -> OpenHand:
    return OpenHand.load()


def by_the_book(points: np.ndarray, quads: np.ndarray) -> set[tuple[float, ...]]:
    """Catmull and Clark's three rules, one point at a time."""
    centre = [points[quad].mean(0) for quad in quads]
    edges: dict[tuple[int, int], list[int]] = {}
    for f, quad in enumerate(quads):
        for k in range(4):
            edges.setdefault(tuple(sorted((int(quad[k]), int(quad[k - 1])))), []).append(f)
    new = list(centre)
    new += [(points[a] + points[b] + centre[f] + centre[g]) / 4 for (a, b), (f, g) in edges.items()]
    for v, point in enumerate(points):
        faces = np.mean([centre[f] for f, quad in enumerate(quads) if v in quad], axis=0)
        middles = [(points[a] + points[b]) / 2 for a, b in edges if v in (a, b)]
        n = len(middles)
        new.append((faces + 2 * np.mean(middles, axis=0) + (n - 3) * point) / n)
    return {tuple(np.round(p, 9) + 0.0) for p in new}


def test_one_step_on_a_cube() -> None:
    rng = np.random.default_rng(0)
    points = CUBE + 0.1 * rng.standard_normal(CUBE.shape)
    step = catmull_clark(CUBE_QUADS, 8)
    fine = step.matrix @ points
    assert {tuple(np.round(p, 9) + 0.0) for p in fine} == by_the_book(points, CUBE_QUADS)
    centres = step.quads[:, 2]
    np.testing.assert_allclose(fine[centres], points[CUBE_QUADS].mean(1).repeat(4, 0), atol=1e-12)


def test_corner_order_is_kept() -> None:
    step = catmull_clark(CUBE_QUADS, 8)
    np.testing.assert_array_equal(step.quads[:, 0], CUBE_QUADS.ravel())


@pytest.mark.parametrize("level", [1, 2, 3, 4])
def test_counts_and_euler_number(hand: OpenHand, level: int) -> None:
    coarse, quads = len(hand.template.vertices), len(hand.template.quads)
    faces = quads * 4**level
    vertices = coarse + 3 * quads * (4**level - 1) // 3  # each step adds Q faces and 2 Q edges
    assert hand.quads(level).shape == (faces, 4)
    assert hand.quads(level).max() + 1 == vertices
    assert vertices - 2 * faces + faces == 2
    assert hand.subdivide(torch.zeros(coarse, 1), level).shape == (vertices, 1)


def test_constants_and_affine_maps_pass_through(hand: OpenHand) -> None:
    vertices = torch.tensor(hand.template.vertices)
    ones = hand.subdivide(torch.ones(len(vertices), 1, dtype=torch.float64), 3)
    torch.testing.assert_close(ones, torch.ones_like(ones), atol=1e-12, rtol=0)
    affine, shift = torch.randn(3, 3, generator=torch.Generator().manual_seed(0)).double(), torch.tensor([1.0, 2, 3])
    after = hand.subdivide(vertices, 2) @ affine + shift
    torch.testing.assert_close(hand.subdivide(vertices @ affine + shift, 2), after, atol=1e-12, rtol=0)


def test_subdivision_is_differentiable(hand: OpenHand) -> None:
    vertices = torch.tensor(hand.template.vertices, requires_grad=True)
    hand.subdivide(vertices, 2).sum().backward()
    assert vertices.grad is not None and vertices.grad.min() > 0


def test_a_point_of_the_skin_keeps_its_uv(hand: OpenHand) -> None:
    for level in (0, 1):
        coarse, fine = hand.topology(level), hand.topology(level + 1)
        step = linear_step(hand.template.uv_quads, len(hand.template.uvs))
        # the first corner of fine quad 4 q + k is corner k of coarse quad q, at every level
        old = np.stack(
            [coarse.uv_faces[0::2, 0], coarse.uv_faces[0::2, 1], coarse.uv_faces[0::2, 2], coarse.uv_faces[1::2, 2]], 1
        )
        np.testing.assert_allclose(fine.uvs[fine.uv_faces[0::2, 0]], coarse.uvs[old.ravel()], atol=1e-12)
        assert len(step.quads) == 4 * len(hand.template.quads)
    assert np.array_equal(hand.topology(2).faces.shape, hand.topology(2).uv_faces.shape)


def uv_triangles(hand: OpenHand) -> np.ndarray:
    topology = hand.topology(0)
    return topology.uvs[topology.uv_faces]


def signed_area(triangles: np.ndarray) -> np.ndarray:
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def coverage(triangles: np.ndarray, size: int) -> np.ndarray:
    """How many triangles hold each texel centre (size, size), boundaries counted once at most."""
    count = np.zeros((size, size), dtype=int)
    for corners in triangles * size:
        low = np.maximum(np.floor(corners.min(0) - 0.5).astype(int), 0)
        high = np.minimum(np.ceil(corners.max(0) + 0.5).astype(int), size)
        x, y = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
        inside = np.ones(x.shape, dtype=bool)
        for k in range(3):
            (x0, y0), (x1, y1) = corners[k], corners[(k + 1) % 3]
            inside &= (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) > 1e-9
        count[low[1] : high[1], low[0] : high[0]] += inside
    return count


def test_uvs_fill_the_square_without_overlap(hand: OpenHand) -> None:
    triangles = uv_triangles(hand)
    assert triangles.min() > 0 and triangles.max() < 1
    area = signed_area(triangles)
    assert area.min() > 1e-7, "no flipped or empty triangle"
    count = coverage(triangles, 512)
    assert count.max() == 1, f"{(count > 1).sum()} texels are claimed twice"
    assert area.sum() > 0.65
    assert abs((count > 0).mean() - area.sum()) < 0.01


def test_texel_density_is_even_on_the_hand(hand: OpenHand) -> None:
    topology = hand.topology(0)
    a, b, c = (hand.template.vertices[topology.faces[:, k]] for k in range(3))
    skin = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    density = signed_area(uv_triangles(hand)) / skin
    owner = np.array(hand.joint_names)[hand.weights(0)[topology.faces[:, 0]].argmax(1)]
    of = {name: np.median(density[owner == name]) for name in hand.joint_names}
    of_hand = [value for name, value in of.items() if name != "forearm"]
    assert max(of_hand) / min(of_hand) < 1.8


def test_charts_keep_two_texels_of_gutter_at_128(hand: OpenHand) -> None:
    """Texels of different charts of the atlas, drawn at 512, stay 8 apart: two texels at 128."""
    from scipy.ndimage import distance_transform_edt
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    topology = hand.topology(0)
    pairs = topology.uv_faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(topology.uvs),) * 2)
    count, label = connected_components(graph, directed=False)
    assert count == 3, "hand, forearm, cap"
    for chart in range(count):
        mine = label[topology.uv_faces[:, 0]] == chart
        own, others = (coverage(uv_triangles(hand)[rows], 512) > 0 for rows in (mine, ~mine))
        assert distance_transform_edt(~others)[own].min() >= 8
