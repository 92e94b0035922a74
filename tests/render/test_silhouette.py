"""Coverage against rays, and its gradient against differences of rays that are shot much denser."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from handbench.errors import InputError
from handbench.hand import hand_model
from handbench.render.see.raster import rasterise
from handbench.render.silhouette import EdgeTable, coverage, outline, silhouette
from handbench.scene import Camera, Mesh, Pose

SIZE = (96, 128)
CAMERA = Camera(
    "front", *SIZE, [[150, 0, 48], [0, 150, 64], [0, 0, 1]], np.c_[np.diag([1.0, -1.0, -1.0]), [0, 0.05, 0.4]]
)
LEVEL = 1

POSES = {
    "open": ("open", (0.0, 0.0, 0.0)),
    "fist": ("fist", (0.3, 0.4, 0.1)),
    "fingers behind fingers": ("open", (0.1, 1.4, 0.2)),
    "pinch from the side": ("pinch", (-0.4, -1.1, 0.6)),
    "from the tips": ("point", (1.3, 0.2, -0.3)),
}


def posed(name: str) -> Mesh:
    hand = hand_model()
    pose, turn = POSES[name]
    joints = hand.named_pose(pose).joints
    return hand.mesh(hand.sample_identity(np.random.default_rng(3)), Pose(joints, turn, (0.004, -0.02, 0.0)), LEVEL)


@pytest.fixture(scope="module")
def edges() -> EdgeTable:
    return EdgeTable(hand_model().topology(LEVEL).faces)


@pytest.mark.parametrize("name", POSES)
def test_coverage_is_that_of_many_rays(name: str, edges: EdgeTable) -> None:
    mesh = posed(name)
    alpha = silhouette(torch.tensor(mesh.vertices), edges, CAMERA).numpy()
    truth = rasterise(mesh, CAMERA, 12).alpha
    assert np.abs(alpha - truth).max() < 0.12  # a corner inside a pixel, between the lines
    assert np.abs(alpha - truth).sum() < 0.003 * truth.sum()


def directions(mesh: Mesh) -> list[np.ndarray]:
    """Ways to move the vertices, each up to about a pixel: a shift, towards the camera, a wave through the fingers."""
    v = mesh.vertices
    still = np.zeros_like(v)
    found = [still + np.array([0.003, -0.002, 0.0]), still + np.array([0.0, 0.0, 0.008])]
    found.append(0.0015 * np.sin(v @ np.random.default_rng(1).normal(0, 60, (3, 3))))
    bulge = np.exp(-(((v - v[4000]) / 0.02) ** 2).sum(axis=1, keepdims=True))  # one place alone
    found.append(0.003 * bulge * (v - v.mean(axis=0)) / 0.05)
    return found


@pytest.mark.parametrize("name", ["open", "fist", "fingers behind fingers", "pinch from the side"])
def test_the_gradient_is_that_of_dense_rays_within_two_percent(name: str, edges: EdgeTable) -> None:
    mesh = posed(name)
    weight = gaussian_filter(np.random.default_rng(0).normal(size=SIZE[::-1]), 6.0)
    weight /= np.abs(weight).max()
    vertices = torch.tensor(mesh.vertices, requires_grad=True)
    (silhouette(vertices, edges, CAMERA) * torch.from_numpy(weight)).sum().backward()
    assert vertices.grad is not None

    def loss(moved: np.ndarray) -> float:
        return float((rasterise(Mesh(moved, mesh.topology), CAMERA, 12).alpha * weight).sum())

    ways, step = directions(mesh), 0.5
    ours = np.array([(vertices.grad.numpy() * way).sum() for way in ways])
    rays = np.array([loss(mesh.vertices + step * way) - loss(mesh.vertices - step * way) for way in ways]) / (2 * step)
    assert np.linalg.norm(ours - rays) < 0.02 * np.linalg.norm(rays)


def square(left: float, top: float, side: float) -> np.ndarray:
    return np.array([[left, top], [left + side, top], [left + side, top + side], [left, top + side]], dtype=float)


QUAD = np.array([[0, 1, 2], [0, 2, 3]])


def test_a_square_has_its_area_and_its_sides_pull_with_their_length() -> None:
    places = torch.tensor(square(3.3, 2.6, 5.0), requires_grad=True)
    alpha = coverage(places, EdgeTable(QUAD), 12, 10, lines=16)
    assert alpha.sum().item() == pytest.approx(25.0, rel=1e-2)
    alpha.sum().backward()
    expected = 2.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])  # d area / d corner of a square of side 5
    assert places.grad is not None
    np.testing.assert_allclose(places.grad.numpy(), expected, atol=0.1)


def test_what_is_inside_another_outline_neither_covers_nor_pulls() -> None:
    places = torch.tensor(np.concatenate([square(2, 2, 8), square(4, 4, 2)]), requires_grad=True)
    both = coverage(places, EdgeTable(np.concatenate([QUAD, QUAD + 4])), 12, 12)
    alone = coverage(places[:4], EdgeTable(QUAD), 12, 12)
    assert torch.equal(both, alone)
    both.sum().backward()
    assert places.grad is not None and not places.grad[4:].any() and places.grad[:4].all()


def test_faces_may_be_turned_either_way() -> None:
    flipped = np.array([[0, 1, 2], [0, 3, 2]])
    places = torch.tensor(square(2.2, 2.2, 4.0))
    for faces in (flipped, QUAD[:, ::-1].copy()):
        assert torch.equal(coverage(places, EdgeTable(faces), 9, 9), coverage(places, EdgeTable(QUAD), 9, 9))


def test_a_surface_beyond_the_edge_of_the_picture_is_cut_there() -> None:
    places = torch.tensor(square(-5.0, -7.0, 100.0), requires_grad=True)
    alpha = coverage(places, EdgeTable(QUAD), 8, 6)
    assert (alpha == 1).all()
    alpha.sum().backward()
    assert places.grad is not None and not places.grad.any()


def test_the_outline_has_the_length_and_normals_of_a_square() -> None:
    found = outline(square(2.0, 3.0, 5.0), EdgeTable(QUAD), 12, 12, 3)
    assert found.length.sum() == pytest.approx(20.0)
    middle = np.array([4.5, 5.5])
    assert ((found.place - middle) * found.normal).sum(axis=1) == pytest.approx(2.5)
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1.0)


def test_bad_places_and_a_surface_behind_the_camera_are_refused(edges: EdgeTable) -> None:
    with pytest.raises(InputError, match="not in front of the camera"):
        silhouette(torch.tensor(posed("open").vertices) + torch.tensor([0.0, 0.0, 0.5]), edges, CAMERA)
    broken = torch.tensor(square(2, 2, 3))
    broken[0, 0] = float("nan")
    with pytest.raises(InputError, match="NaN"):
        coverage(broken, EdgeTable(QUAD), 8, 8)
