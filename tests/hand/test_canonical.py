"""Canonicalisation: what skinning did is undone, on the open hand and on a small one of MANO's structure."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from handbench.errors import InputError
from handbench.hand import HandModel, hand_model
from handbench.hand.canonical import AllBones, Deformation, NearestBones, WeightField, attached, canonicalise
from handbench.lattice import Lattice

from .test_handmodel import SyntheticMano


@pytest.fixture(scope="module")
def hand() -> HandModel:
    return hand_model()


@pytest.fixture(scope="module")
def field(hand: HandModel) -> WeightField:
    return WeightField.of(hand)


def _posed(field: WeightField, seed: int, name: str | None = None) -> tuple[Deformation, Tensor]:
    """A deformation of a random person, and the coarse vertices of exact skinning."""
    rng = np.random.default_rng(seed)
    shape = torch.tensor(np.asarray(field.hand.sample_identity(rng))).float()
    pose = field.hand.sample_pose(rng) if name is None else field.hand.named_pose(name)
    joints = torch.tensor(pose.joints).float()
    return Deformation(field, shape, joints), field.hand.skin(shape, joints)


def _around(skin: Tensor, count: int, spread: float) -> Tensor:
    random = torch.Generator().manual_seed(0)
    vertices = torch.randint(len(skin), (count,), generator=random)
    return skin[vertices] + spread * torch.randn(count, 3, generator=random)


def test_a_lattice_interpolates_what_is_linear_in_each_axis_exactly_and_knows_its_slopes() -> None:
    lattice = Lattice(torch.tensor([-1.0, 0.0, 2.0]), torch.tensor([1.0, 3.0, 3.0]), (5, 4, 3))

    def f(p: Tensor) -> Tensor:
        x, y, z = p.unbind(1)
        return torch.stack([1 + x - 2 * y + z + 0.5 * x * y * z, x * y], dim=1)

    points = lattice.low + torch.rand(50, 3, generator=torch.Generator().manual_seed(1)) * (lattice.high - lattice.low)
    table = f(lattice.nodes())
    assert torch.allclose(lattice.values(table, points), f(points), atol=1e-5)
    points.requires_grad_(True)
    wanted = [torch.autograd.grad(column.sum(), points, retain_graph=True)[0] for column in f(points).unbind(1)]
    assert torch.allclose(lattice.slopes(table, points.detach()), torch.stack(wanted, dim=2), atol=1e-4)
    assert torch.equal(lattice.nearest(lattice.nodes()), torch.arange(lattice.size))


def test_the_gradient_of_a_lattice_by_its_table_is_exact() -> None:
    lattice = Lattice(torch.zeros(3, dtype=torch.float64), torch.ones(3, dtype=torch.float64), (3, 2, 4))
    points = torch.rand(6, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    table = torch.rand(lattice.size, 2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda t: lattice.values(t, points), table)
    assert torch.autograd.gradcheck(lambda t: lattice.slopes(t, points), table)


@pytest.mark.parametrize("starts", [AllBones(), NearestBones()])
def test_the_neutral_hand_at_rest_is_where_it_was(field: WeightField, starts: AllBones | NearestBones) -> None:
    deformation = Deformation(field, field.shape, torch.zeros(len(field.hand.parents), 3))
    points = _around(field.coarse, 300, 3e-3)
    roots = canonicalise(deformation, points, starts)
    assert roots.valid.sum(dim=1).eq(1).all()
    assert torch.allclose(roots.x[roots.valid], points, atol=1e-6)


@pytest.mark.parametrize("name", [None, "fist"])
@pytest.mark.parametrize("starts", [AllBones(), NearestBones(4)])
def test_roots_go_back_to_their_points(field: WeightField, name: str | None, starts: AllBones | NearestBones) -> None:
    deformation, skin = _posed(field, 3, name)
    points = _around(skin, 500, 3e-3)
    roots = canonicalise(deformation, points, starts)
    image, wanted = deformation.forward(roots.x[roots.valid]), points[roots.valid.nonzero()[:, 0]]
    assert (image - wanted).norm(dim=1).max() < 1e-5
    assert roots.valid.any(dim=1).float().mean() > 0.99


def test_the_skin_is_found_where_it_is_at_rest(field: WeightField) -> None:
    """From the posed vertices back to those at rest, within what the field is off from exact skinning."""
    deformation, skin = _posed(field, 4)
    off = (deformation.forward(field.coarse) - skin).norm(dim=1)
    assert off.median() < 3e-4 and off.quantile(0.95) < 1e-3 and off.max() < 4e-3
    roots = canonicalise(deformation, skin, NearestBones(3))
    distance = (roots.x - field.coarse[:, None]).norm(dim=2).where(roots.valid, torch.inf).amin(dim=1)
    assert distance.median() < 4e-4
    assert (distance < 2e-3).float().mean() > 0.9  # skin that is folded up has roots elsewhere too


def test_points_between_touching_fingers_have_a_root_in_each(field: WeightField) -> None:
    hand = field.hand
    deformation, skin = _posed(field, 0, "fist")
    finger = {j: f for f, chain in enumerate(hand.chains) for j in chain}
    owner = torch.tensor([finger.get(int(b), -1) for b in field.bone])
    index, middle = (owner == 1).nonzero()[:, 0], (owner == 2).nonzero()[:, 0]
    distance = torch.cdist(skin[index], skin[middle])
    near = (distance < 2.5e-3).nonzero()
    assert len(near) > 10
    points = (skin[index[near[:, 0]]] + skin[middle[near[:, 1]]]) / 2
    roots = canonicalise(deformation, points)
    sheets = torch.stack(
        [
            (torch.cdist(roots.x.flatten(0, 1), field.coarse[part]).amin(dim=1).unflatten(0, (len(points), -1)) < 4e-3)
            for part in (index, middle)
        ]
    )
    both = (sheets & roots.valid).any(dim=2).all(dim=0)
    assert both.float().mean() > 0.8


def test_the_nearest_bones_lose_few_roots_on_the_skin(field: WeightField) -> None:
    """Against all bones: roots nearer to the skin at rest than the nearest bones' best one (the seed's union)."""
    deformation, skin = _posed(field, 5)
    points = _around(skin, 300, 2e-3)
    off = []
    for starts in (NearestBones(), AllBones()):
        roots = canonicalise(deformation, points, starts)
        each = torch.cdist(roots.x.flatten(0, 1), field.rest).amin(dim=1).view(roots.valid.shape)
        off.append(each.where(roots.valid, torch.inf).amin(dim=1))
    worse = off[0] > off[1] + 1e-3
    assert worse.float().mean() < 0.02


@pytest.mark.parametrize("joint", ["index1", "thumb2"])
def test_the_gradient_to_the_pose_is_that_of_finite_differences(field: WeightField, joint: str) -> None:
    """On the finger that turns; the differences are of roots that Newton's method follows from the unturned pose."""
    number = field.hand.joint_names.index(joint)
    joints = torch.tensor(field.hand.sample_pose(np.random.default_rng(7)).joints).float()
    rigid = field.coarse[(torch.tensor(field.hand.weights(0))[:, number] > 0.7)][:8]
    points = Deformation(field, field.shape, joints).forward(rigid)

    def followed(turned: Tensor) -> Tensor:
        x, deformation = rigid, Deformation(field, field.shape, turned)
        for _ in range(6):
            x = attached(deformation, points, x).detach()
        return x

    step = torch.zeros_like(joints)
    step[number, 0] = 2e-3
    wanted = (followed(joints + step) - followed(joints - step)) / 4e-3
    assert wanted.norm(dim=1).max() > 0.005
    turn = joints.clone().requires_grad_(True)
    x = attached(Deformation(field, field.shape, turn), points, rigid)
    rows = [torch.autograd.grad(value, turn, retain_graph=True)[0][number, 0] for value in x.flatten()]
    assert torch.allclose(torch.stack(rows).view(-1, 3), wanted, rtol=0.05, atol=1e-3)


def test_the_gradient_to_a_point_is_the_inverse_jacobian(field: WeightField) -> None:
    deformation, skin = _posed(field, 8)
    roots = canonicalise(deformation, skin[:50], NearestBones(1))
    x, points = roots.x[:, 0][roots.valid[:, 0]], skin[:50][roots.valid[:, 0]].requires_grad_(True)
    (gradient,) = torch.autograd.grad(attached(deformation, points, x)[:, 0].sum(), points)
    unit = (gradient[:, None] @ deformation.jacobian(x)).squeeze(1)
    assert torch.allclose(unit, torch.tensor([1.0, 0.0, 0.0]).expand_as(unit), atol=1e-3)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_hand_of_manos_structure_is_canonicalised_too(side: str) -> None:
    hand = SyntheticMano(side)  # type: ignore[arg-type]
    field = WeightField.of(hand, np.full(10, 0.5))
    joints = torch.tensor(hand.sample_pose(np.random.default_rng(1)).joints).float()
    deformation = Deformation(field, field.shape, joints)
    points = deformation.forward(field.coarse)
    roots = canonicalise(deformation, points, NearestBones(3))
    assert roots.valid.any(dim=1).float().mean() > 0.9
    image, wanted = deformation.forward(roots.x[roots.valid]), points[roots.valid.nonzero()[:, 0]]
    assert (image - wanted).norm(dim=1).max() < 1e-5


def test_a_hand_without_skinning_weights_is_refused() -> None:
    hand = SyntheticMano()
    hand.skinning = np.zeros((96, 16))
    with pytest.raises(InputError, match="no skinning weights"):
        WeightField.of(hand)
    with pytest.raises(InputError, match="spacing"):
        WeightField.of(SyntheticMano(), spacing=0.0)


@pytest.mark.parametrize("count", [0, 5])
def test_roots_are_searched_from_one_to_four_nearest_bones(count: int) -> None:
    with pytest.raises(InputError, match=f"nearest {count} bones"):
        NearestBones(count)
