"""A posed hand of PALM-Net whose surface is known: what rays see of it is what a rasteriser draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from handbench.hand import hand_model
from handbench.lattice import Lattice
from handbench.methods.palm.config import PRESETS
from handbench.methods.palm.fields import Geometry
from handbench.methods.palm.model import Conditions, PalmModel
from handbench.methods.palm.posed import FAR, PosedHand, Rendering, render
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import rasterise
from handbench.render.volume import Marching, Shell
from handbench.scene import Camera, Mesh
from handbench.skips import NONE, Skips, skipping, tallied

POSED = {"rotation": torch.tensor([0.3, -0.4, 0.2]), "translation": torch.tensor([0.02, 0.05, -0.03])}


class Known(PalmModel):
    """A model whose geometry is the hand model's skin at rest, plus an offset in metres."""

    def __init__(self, **changed: object) -> None:
        torch.manual_seed(0)
        super().__init__(replace(PRESETS["smoke"], beta=5e-4, **changed), hand_model(), 1)
        mesh = self.hand.mesh(self.hand.neutral(), self.hand.named_pose("rest"), 1)
        self.shell = Shell.around(mesh.vertices, mesh.topology.faces, 0.01, 3e-3)
        self.offset = torch.zeros((), requires_grad=True)

    def geometry(self, x: Tensor, conditions: Conditions, gradient: bool = False) -> Geometry:
        lattice: Lattice = self.shell.lattice
        sdf = lattice.values(self.shell.distance, x)[:, 0] - self.offset
        slope = lattice.slopes(self.shell.distance, x)[..., 0]
        if x.requires_grad:  # a lattice gives no gradient to places; the slope is it
            sdf = sdf + (slope.detach() * (x - x.detach())).sum(dim=1)
        return Geometry(sdf, torch.zeros(len(x), 1 + self.config.features), slope if gradient else None)


@pytest.fixture(scope="module")
def model() -> Known:
    return Known()


def _hand(model: PalmModel, seed: int = 2) -> tuple[PosedHand, Mesh]:
    hand, rng = model.hand, np.random.default_rng(seed)
    shape, pose = np.asarray(hand.sample_identity(rng)), hand.sample_pose(rng)
    told = replace(pose, rotation=POSED["rotation"].numpy(), translation=POSED["translation"].numpy())
    with torch.no_grad():
        joints = torch.tensor(pose.joints).float()
        posed = PosedHand(model, model.codes(0), torch.tensor(shape).float(), joints, **POSED)
    return posed, hand.mesh(shape, told, 1)


def _camera(mesh: Mesh, side: int = 40) -> Camera:
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    at = np.eye(3)
    return Camera(
        "front",
        side,
        side,
        np.array([[2.0 * side, 0, side / 2], [0, 2.0 * side, side / 2], [0, 0, 1]]),
        np.concatenate([at, (np.array([0, 0, 0.6]) - middle)[:, None]], axis=1),
    )


def _rays(camera: Camera) -> tuple[Tensor, Tensor]:
    directions = torch.from_numpy(camera.rays().reshape(-1, 3)).float()
    origin = torch.from_numpy(camera.centre.copy()).float()
    return origin.expand(len(directions), 3), torch.nn.functional.normalize(directions, dim=1)


@pytest.fixture(scope="module")
def scene(model: Known) -> tuple[PosedHand, Mesh, Camera]:
    posed, mesh = _hand(model)
    return posed, mesh, _camera(mesh)


@torch.no_grad()
def _seen(posed: PosedHand, camera: Camera, samples: int = 24) -> Rendering:
    return render(posed, *_rays(camera), Marching(samples=samples))


def test_rays_see_what_a_rasteriser_draws(scene: tuple[PosedHand, Mesh, Camera]) -> None:
    posed, mesh, camera = scene
    found, drawn = _seen(posed, camera), rasterise(mesh, camera)
    alpha = found.alpha.numpy().reshape(40, 40)
    true = drawn.alpha
    inside, outside = true > 0.999, true == 0
    assert inside.sum() > 100 and alpha[inside].mean() > 0.98 and alpha[outside].mean() < 0.02
    assert ((alpha > 0.5) & (true > 0.5)).sum() / ((alpha > 0.5) | (true > 0.5)).sum() > 0.92
    along = _rays(camera)[1] @ torch.from_numpy(camera.rotation[2]).float()  # distance along the ray to depth
    depth = (found.depth * along).numpy().reshape(40, 40)
    assert np.median(np.abs(depth - drawn.depth_map)[inside]) < 1e-3
    normal = torch.nn.functional.normalize(found.total(found.normal), dim=1).numpy().reshape(40, 40, 3)
    assert np.median((normal * drawn.normal_map).sum(axis=-1)[inside]) > 0.98
    assert found.weight.min() > 0.0 and (found.ray.diff() >= 0).all()


def test_normals_are_those_of_the_posed_mesh(scene: tuple[PosedHand, Mesh, Camera]) -> None:
    posed, mesh, _ = scene
    surface = posed.surface(3e-3)
    gradient = posed.model.geometry(surface.canonical, posed.conditions, gradient=True).gradient
    _, nearest = cKDTree(mesh.vertices).query(surface.mesh.vertices)
    true = torch.from_numpy(PosedMesh(mesh).normals[nearest]).float()
    cosine = (posed.normals(surface.canonical, gradient) * true).sum(dim=1)
    assert cosine.median() > 0.99 and (cosine > 0.8).float().mean() > 0.9


def test_the_surface_is_the_hand(scene: tuple[PosedHand, Mesh, Camera]) -> None:
    """Marching cubes at rest, moved by the pose, against exact skinning; faces turn outwards."""
    posed, mesh, _ = scene
    found = posed.mesh(3e-3)
    distance, _ = cKDTree(mesh.vertices).query(found.vertices)
    assert np.median(distance) < 2e-3 and np.quantile(distance, 0.95) < 5e-3  # and no sheet inside
    corners = found.vertices[found.topology.faces]
    volume = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    exact = mesh.vertices[mesh.topology.faces]
    true = np.einsum("ni,ni->n", exact[:, 0], np.cross(exact[:, 1], exact[:, 2])).sum() / 6
    assert volume == pytest.approx(true, rel=0.1)


def test_signed_distances_are_far_where_there_is_no_hand(scene: tuple[PosedHand, Mesh, Camera]) -> None:
    posed, mesh, _ = scene
    box = posed.box
    assert (box[0].numpy() < mesh.vertices.min(axis=0)).all() and (box[1].numpy() > mesh.vertices.max(axis=0)).all()
    points = torch.from_numpy(np.concatenate([mesh.vertices[::50], [[1.0, 1.0, 1.0]]])).float()
    found = posed.sdf(points)
    assert found[-1] == FAR and found[:-1].abs().median() < 5e-4
    assert posed.density(points)[-1] < 1e-6 < posed.density(points)[:-1].median()


def test_skips_change_no_picture_by_more_than_a_hundredth(scene: tuple[PosedHand, Mesh, Camera]) -> None:
    posed, _, camera = scene
    origins, directions = _rays(camera)
    every = slice(0, None, 3)
    marching = Marching(step=1e-3, samples=32)

    def alpha(skips: Skips) -> Tensor:
        with skipping(skips), torch.no_grad():
            return render(posed, origins[every], directions[every], marching).alpha

    plain = alpha(NONE)
    for switch in ("outside_box", "empty_space", "saturated", "weightless"):
        difference = (alpha(replace(Skips(), **{switch: False})) - plain).abs()
        assert difference.mean() < 2e-3 and difference.quantile(0.99) < 0.05, switch
    with tallied() as tally:
        assert (alpha(Skips()) - plain).abs().mean() < 2e-3
    lines = tally.lines()
    assert all(lines[name].skipped > 0 for name in ("rays", "ray steps", "ray steps behind", "volume samples"))


def test_gradients_reach_place_pose_and_geometry(model: Known) -> None:
    """How much of the picture the hand covers, by where it is, by its joints and by its size, against differences."""
    with torch.no_grad():
        posed, mesh = _hand(model, 3)
    camera = _camera(mesh, 24)
    origins, directions = _rays(camera)

    def covered(hand: PosedHand) -> Tensor:
        with skipping(replace(Skips(), empty_space=False)):  # the same places for all, and so smooth
            return render(hand, origins, directions, Marching(step=1e-3)).alpha[:288].sum()

    joint = model.hand.joint_names.index("wrist")
    step = {"translation": torch.zeros(3), "joints": torch.zeros_like(posed.joints)}
    step["translation"][1], step["joints"][joint, 2] = 5e-4, 5e-3
    for name in ("translation", "joints"):
        value = getattr(posed, name)
        leaf = value.clone().requires_grad_(True)
        (gradient,) = torch.autograd.grad(covered(posed.moved(**{name: leaf})), leaf)
        with torch.no_grad():
            above, below = (covered(posed.moved(**{name: value + sign * step[name]})) for sign in (1, -1))
        assert float((gradient * step[name]).sum() * 2) == pytest.approx(float(above - below), rel=0.15), name
    (grown,) = torch.autograd.grad(covered(posed), model.offset)
    assert grown > 0


def test_a_moved_hand_is_one_that_is_made_anew(model: Known) -> None:
    posed, mesh = _hand(model)
    camera = _camera(mesh, 24)
    joints = posed.joints + 0.02
    with torch.no_grad():
        fresh = PosedHand(model, posed.codes, posed.shape, joints, **POSED)
    a, b = (_seen(hand, camera) for hand in (posed.moved(joints=joints), fresh))
    assert (a.alpha - b.alpha).abs().mean() < 3e-3


def test_a_hand_nobody_looks_at_is_an_empty_picture(scene: tuple[PosedHand, Mesh, Camera]) -> None:
    posed, _, camera = scene
    origins, directions = _rays(camera)
    with torch.no_grad():
        found = render(posed, origins[:5], -directions[:5])
    assert not found.alpha.any() and not len(found.ray) and found.rays == 5
    assert found.radiance(posed).shape == (5, 3) and not found.radiance(posed).any()
    assert found.depth.isfinite().all()
