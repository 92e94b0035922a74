"""The fields of PALM-Net: encodings, gradients by formula, bounds."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from handbench.errors import InputError
from handbench.hand import hand_model
from handbench.methods.palm.config import PRESETS, PalmConfig
from handbench.methods.palm.encoding import Encoding, HashGrid, TriPlane
from handbench.methods.palm.fields import Conditioned, GeometryField, LipschitzLinear, MaterialField
from handbench.methods.palm.model import PalmModel
from handbench.methods.palm.settings import settings

ASPECT = [0.5, 1.0, 0.4]


def _encoding(name: str) -> Encoding:
    torch.manual_seed(0)
    made = TriPlane((6, 11), 17, 3, ASPECT) if name == "triplane" else HashGrid(4, 2, 8, 4, 40.0, ASPECT)
    for table in made.parameters():
        nn.init.normal_(table)
    return made.double()


def _places(count: int) -> Tensor:
    return 1.8 * torch.rand(count, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64) - 0.9


@pytest.mark.parametrize("name", ["triplane", "hash"])
def test_slopes_are_those_of_finite_differences(name: str) -> None:
    encoding, x, step = _encoding(name), _places(40), 1e-6
    values, slopes = encoding.with_slopes(x)
    assert torch.equal(values, encoding(x)) or torch.allclose(values, encoding(x), atol=1e-12)
    for axis in range(3):
        shift = step * torch.eye(3, dtype=torch.float64)[axis]
        wanted = (encoding(x + shift) - encoding(x - shift)) / (2 * step)
        assert torch.allclose(slopes[:, axis], wanted, atol=1e-5)


def test_a_coarse_level_of_a_hash_grid_is_a_whole_grid() -> None:
    grid = _encoding("hash")
    assert isinstance(grid, HashGrid)
    assert grid.rows[0] == np.prod(grid.counts[0]) and grid.rows[-1] == 2**8
    assert [max(counts) for counts in grid.counts] == sorted(max(counts) for counts in grid.counts)
    assert max(grid.counts[-1]) == 40


@pytest.mark.parametrize(("base", "finest"), [(16, 512), (16, 2048), (4, 40), (10, 1000)])
def test_the_finest_level_of_a_hash_grid_is_as_fine_as_told(base: int, finest: int) -> None:
    """Whatever roots and powers round to: 16 * (2048 / 16) ** (1 / 15) to the fifteenth is below 2048."""
    for levels in range(2, 24):
        assert max(HashGrid(levels, 1, 4, base, finest, ASPECT).counts[-1]) == finest, levels


def test_a_code_changes_how_inputs_are_mixed_and_nothing_without_a_code() -> None:
    """Modulated, a person's code may turn an input on that another's turns off; by biases alone it cannot."""
    torch.manual_seed(0)
    x, codes = torch.randn(6, 5), torch.randn(2, 3)
    for modulated in (False, True):
        network = Conditioned(5, 3, (), 2, nn.ReLU(), modulated)
        change = [network(x, code) - network(x, torch.zeros(3)) for code in codes]
        flat = all(torch.allclose(moved, moved[:1].expand(6, 2), atol=1e-6) for moved in change)
        assert flat is not modulated
    assert torch.equal(network(x, torch.zeros(3)), network.layers[0](x))


def _field(hidden: tuple[int, ...]) -> tuple[GeometryField, Tensor, Tensor]:
    field = GeometryField(_encoding("triplane"), 5, hidden, 4).double()
    with torch.no_grad():
        for parameter in field.network.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(2)))
    return field, torch.tensor(ASPECT, dtype=torch.float64), torch.ones(5, dtype=torch.float64)


@pytest.mark.parametrize("hidden", [(16,), (16, 16, 16)])
def test_the_gradient_of_the_distance_is_that_of_finite_differences(hidden: tuple[int, ...]) -> None:
    field, aspect, code = _field(hidden)
    x, step = _places(30), 1e-6
    for graph in (True, False):
        with torch.set_grad_enabled(graph):
            sdf, outputs, gradient = field.with_gradient(x, aspect, code)
        assert torch.allclose(sdf, field(x, aspect, code)[0]) and torch.allclose(outputs[:, 0], sdf)
        assert [v.requires_grad for v in (sdf, outputs, gradient)] == [graph] * 3
        for axis in range(3):
            shift = step * torch.eye(3, dtype=torch.float64)[axis] / aspect
            wanted = (field(x + shift, aspect, code)[0] - field(x - shift, aspect, code)[0]) / (2 * step)
            assert torch.allclose(gradient[:, axis], wanted, atol=1e-4)


def test_losses_of_the_gradient_can_be_differentiated() -> None:
    """The eikonal term by each kind of parameter: tables, first and last layer."""
    field, aspect, code = _field((16, 16))
    x = _places(20)

    def loss() -> Tensor:
        return (field.with_gradient(x, aspect, code)[2].norm(dim=1) - 1.0).square().mean()

    chosen = [next(field.encoding.parameters()), field.network.layers[0].weight, field.network.layers[2].weight]
    found = torch.autograd.grad(loss(), chosen)
    for parameter, gradient in zip(chosen, found, strict=True):
        at = int(gradient.abs().argmax())
        with torch.no_grad():
            flat, step = parameter.view(-1), 1e-6
            flat[at] += step
            above = loss()
            flat[at] -= 2 * step
            below = loss()
            flat[at] += step
        assert float((above - below) / (2 * step)) == pytest.approx(float(gradient.view(-1)[at]), rel=1e-4)


def test_geometry_begins_as_a_sphere() -> None:
    torch.manual_seed(0)
    field = GeometryField(TriPlane((8,), 8, 2, [1.0, 1.0, 1.0]), 3, (256,), 4)
    directions = nn.functional.normalize(torch.randn(200, 3), dim=1)
    inside, outside = (field(radius * directions, torch.ones(3), torch.zeros(3))[0].mean() for radius in (0.2, 0.9))
    assert inside < -0.1 and outside > 0.1


def test_a_bounded_layer_never_changes_faster_than_its_bound() -> None:
    torch.manual_seed(0)
    layer = LipschitzLinear(6, 4)
    with torch.no_grad():
        layer.weight.mul_(50.0)
        layer.bound.fill_(0.5)
    most = float(nn.functional.softplus(layer.bound.detach()))
    step = 0.1 * torch.sign(torch.randn(100, 6))
    x = torch.randn(100, 6)
    change = (layer(x + step) - layer(x)).abs().max()
    assert change <= most * 0.1 * (1 + 1e-4) and change > 0.5 * most * 0.1
    free = LipschitzLinear(6, 4)
    assert torch.allclose(free(x), nn.functional.linear(x, free.weight, free.bias))


@pytest.mark.parametrize("modulated", [False, True])
def test_materials_are_in_their_ranges(modulated: bool) -> None:
    torch.manual_seed(0)
    field = MaterialField(6, 5, 4, (16,), lipschitz=True, modulated=modulated)
    made = field(1e3 * torch.randn(50, 6), torch.randn(50, 5), torch.randn(4))
    assert made.albedo.min() >= 0.03 and made.albedo.max() <= 0.8 + 1e-6
    assert made.roughness.min() >= 0.09 and made.roughness.max() <= 0.99 + 1e-6
    assert made.metallic.min() >= 0.0 and made.metallic.max() <= 1.0 and made.albedo.shape == (50, 3)


@pytest.mark.parametrize("name", ["quick", "smoke"])
def test_a_model_of_a_preset_answers_for_each_person_and_pose(name: str) -> None:
    torch.manual_seed(0)
    hand = hand_model()
    model = PalmModel(PRESETS[name], hand, 2)
    with torch.no_grad():
        model.phi[1], model.psi[1] = 1.0, 1.0
        for field in (model.geometry_field.network.code, model.radiance_field.network.code):
            nn.init.normal_(field.weight, std=0.1)
    shape, joints = torch.tensor(np.asarray(hand.neutral())).float(), torch.zeros(len(hand.parents), 3)
    x = model.field.coarse[:10]
    found = [model.geometry(x, model.conditions(model.codes(p), shape, joints)).sdf for p in (0, 1)]
    assert not torch.allclose(found[0], found[1])
    bent = joints.clone()
    bent[10, 0] = 1.0
    other = model.geometry(x, model.conditions(model.codes(0), shape, bent)).sdf
    assert not torch.allclose(found[0], other)
    bent = joints.clone()
    bent[0] = 1.0  # the root's turn is where the hand is, not what it does
    assert torch.equal(found[0], model.geometry(x, model.conditions(model.codes(0), shape, bent)).sdf)


def test_the_distance_gives_its_gradient_to_places() -> None:
    """As the pose needs it: through tables too, with networks that are fixed."""
    torch.manual_seed(0)
    hand = hand_model()
    model = PalmModel(PRESETS["smoke"], hand, 1).requires_grad_(False)
    for table in model.geometry_field.encoding.parameters():
        nn.init.normal_(table, std=0.1)
    nn.init.normal_(model.geometry_field.network.layers[0].weight, std=0.1)
    shape, joints = torch.tensor(np.asarray(hand.neutral())).float(), torch.zeros(len(hand.parents), 3)
    conditions = model.conditions(model.codes(0), shape, joints)
    x = model.field.coarse[:200].clone().requires_grad_(True)
    found = model.geometry(x, conditions)
    (gradient,) = torch.autograd.grad(found.sdf.sum(), x)
    step = 2e-5
    for axis in range(3):
        shift = step * torch.eye(3)[axis]
        above, below = (model.geometry(x.detach() + sign * shift, conditions).sdf for sign in (1, -1))
        wanted = (above - below) / (2 * step)
        assert (gradient[:, axis] - wanted).abs().median() < 0.02 * wanted.abs().median()


def test_presets_say_what_the_seed_and_the_code_say() -> None:
    assert PRESETS["seed"].gaussians == 8 and PRESETS["seed"].rays == 1024 and PRESETS["seed"].steps == 200_000
    assert PRESETS["released"].levels == 32 and PRESETS["released"].geometry == (64,)
    assert PRESETS["released"].eikonal == 1e-5 and PRESETS["released"].beta == 0.3
    with pytest.raises(InputError, match="quick"):
        settings("quik", None)
    with pytest.raises(InputError, match="bones"):
        PalmConfig(bones=9)
    with pytest.raises(InputError, match="beta"):
        PalmConfig(beta=0.0)
    with pytest.raises(InputError, match="places"):
        PalmConfig(places=0)
    with pytest.raises(InputError, match="hidden layer"):
        PalmConfig(geometry=())
