"""Volume rendering: sums along rays against closed forms, and what is skipped against what is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from torch import Tensor

from handbench.errors import InputError
from handbench.render.volume import (
    Intervals,
    Marching,
    Shell,
    laplace_density,
    refined,
    through,
    transmittance,
    weights,
)
from handbench.skips import NONE, Skips, skipping, tallied

RADIUS, CENTRE = 0.03, torch.tensor([0.01, -0.02, 0.4])
BETA = 1e-3


@pytest.fixture(scope="module")
def shell() -> Shell:
    """Around a sphere as a mesh."""
    turn, tilt = np.meshgrid(np.arange(48) / 48 * 2 * np.pi, np.arange(1, 24) / 24 * np.pi)
    ring = np.stack([np.sin(tilt) * np.cos(turn), np.cos(tilt), np.sin(tilt) * np.sin(turn)], axis=-1).reshape(-1, 3)
    vertices = RADIUS * np.concatenate([ring, [[0, 1, 0], [0, -1, 0]]]) + CENTRE.numpy()
    faces = []
    for k in range(48):
        after = (k + 1) % 48
        faces += [[len(ring), after, k], [len(ring) + 1, 22 * 48 + k, 22 * 48 + after]]
        for row in range(22):
            a, b = 48 * row, 48 * row + 48
            faces += [[a + k, a + after, b + k], [a + after, b + after, b + k]]
    return Shell.around(vertices, np.array(faces))


def test_distances_are_exact_where_they_count(shell: Shell) -> None:
    """Beyond reach they are rough, but beyond reach and on the right side."""
    low, high = shell.box
    points = low + (high - low) * torch.rand(20_000, 3, generator=torch.manual_seed(0))
    true, found = (points - CENTRE).norm(dim=1) - RADIUS, shell.at(points)
    near = true.abs() < shell.reach - 1e-3
    assert (found - true)[near].abs().max() < 4e-4  # trilinear between nodes 4 mm apart, of a mesh in the ball
    far = true.abs() > shell.reach + 1e-3
    assert (found[far].abs() > shell.reach).all() and (found[far].sign() == true[far].sign()).all()
    assert near.any() and (found[far] < 0).any() and (found[far] > 0).any()


def _rays(offsets: Tensor) -> tuple[Tensor, Tensor]:
    """Along z, so far from the sphere's centre in x."""
    origins = torch.stack([CENTRE[0] + offsets, torch.full_like(offsets, -0.02), torch.zeros_like(offsets)], dim=1)
    return origins, torch.tensor([0.0, 0.0, 1.0]).expand(len(offsets), 3).contiguous()


def _distance(origins: Tensor, directions: Tensor, found: Intervals) -> Tensor:
    points = origins[found.ray, None] + found.middle[..., None] * directions[found.ray, None]
    return (points - CENTRE).norm(dim=-1) - RADIUS


def _alpha(shell: Shell, offsets: Tensor, marching: Marching) -> Tensor:
    origins, directions = _rays(offsets)
    found = through(shell, origins, directions, marching)
    share = weights(laplace_density(_distance(origins, directions, found), BETA), found.length)
    return torch.zeros(len(offsets)).index_add_(0, found.ray, share.sum(dim=1))


def _closed(offset: float) -> float:
    """What a soft sphere absorbs of a ray that passes its centre at a distance."""

    def density(z: float) -> float:
        return float(laplace_density(torch.tensor(np.hypot(offset, z) - RADIUS), BETA))

    deep = np.sqrt(max(0.0, RADIUS**2 - offset**2))
    return 1.0 - np.exp(-quad(density, -0.06, 0.06, points=[-deep, deep], limit=400)[0])


def test_a_homogeneous_slab_is_exact_for_any_cuts() -> None:
    density, length = 30.0, torch.tensor([[0.01, 0.002, 0.03, 0.008]])
    share = weights(torch.full((1, 4), density), length)
    assert float(share.sum()) == pytest.approx(1.0 - np.exp(-density * 0.05), rel=1e-6)
    assert float(transmittance(torch.full((1, 4), density), length)[0, -1]) == pytest.approx(np.exp(-1.5), rel=1e-6)
    # emission that grows along the ray: second order in the steps
    thickness, expected = 0.05, quad(lambda t: density * np.exp(-density * t) * t, 0.0, 0.05)[0]
    errors = []
    for count in (8, 16, 32):
        cut = torch.full((1, count), thickness / count)
        middle = (torch.arange(count) + 0.5) * thickness / count
        errors.append(abs(float((weights(torch.full((1, count), density), cut) * middle).sum()) - expected))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05) and errors[1] / errors[2] == pytest.approx(
        4.0, rel=0.1
    )


def test_the_density_is_that_of_a_laplace_distribution() -> None:
    d = torch.tensor([-0.05, -1e-3, 0.0, 1e-3, 0.05])
    found = laplace_density(d, 1e-3) * 1e-3
    assert torch.allclose(
        found, torch.tensor([1.0, 1 - 0.5 * np.exp(-1), 0.5, 0.5 * np.exp(-1), 0.0]).float(), atol=1e-6
    )


def test_a_soft_sphere_absorbs_what_its_integral_says(shell: Shell) -> None:
    offsets = torch.tensor([0.0, 0.015, 0.028, 0.0295, 0.031, 0.033])
    expected = torch.tensor([_closed(float(b)) for b in offsets]).float()
    with skipping(NONE):
        fine = _alpha(shell, offsets, Marching(step=1e-4))
    assert torch.allclose(fine, expected, atol=2e-3)
    few = _alpha(shell, offsets, Marching(samples=24))
    assert torch.allclose(few, expected, atol=2e-2)


def test_skips_change_no_picture_by_more_than_their_bound(shell: Shell) -> None:
    """Every switch alone and all together, a hundred rays across the sphere and past it; and each is told."""
    offsets = torch.linspace(-0.07, 0.07, 101)
    marching = Marching(step=5e-4, samples=48)
    with skipping(NONE), tallied() as tally:
        plain = _alpha(shell, offsets, marching)
    assert all(saved.skipped == 0 for saved in tally.lines().values())
    for switch in ("outside_box", "empty_space", "saturated"):
        with skipping(replace(Skips(), **{switch: False})):
            assert (_alpha(shell, offsets, marching) - plain).abs().max() < 1e-2
    with tallied() as tally:
        skipped = _alpha(shell, offsets, marching)
    assert (skipped - plain).abs().max() < 1e-2
    lines = tally.lines()
    assert lines["rays"].total == 101 and lines["rays"].skipped > 30
    assert lines["ray steps"].skipped > 0.3 * lines["ray steps"].total
    assert lines["ray steps behind"].skipped > 0.3 * lines["ray steps behind"].total


def test_samples_lie_where_light_is_absorbed(shell: Shell) -> None:
    origins, directions = _rays(torch.zeros(1))
    found = through(shell, origins, directions, Marching(samples=16))
    front = 0.4 - RADIUS
    assert ((found.middle - front).abs() < 6e-3).float().mean() > 0.6
    assert found.middle.diff(dim=1).ge(0).all() and found.length.gt(0).all()
    share = weights(laplace_density(_distance(origins, directions, found), BETA), found.length)
    again = refined(found, share, 16)
    assert ((again.middle - front).abs() < 3e-3).float().mean() > ((found.middle - front).abs() < 3e-3).float().mean()
    assert torch.allclose(again.length.sum(dim=1), found.length.sum(dim=1), rtol=1e-4)


def test_random_cuts_repeat_and_are_right_on_average(shell: Shell) -> None:
    offsets = torch.full((400,), 0.0297)
    origins, directions = _rays(offsets)

    def alpha(seed: int) -> Tensor:
        found = through(shell, origins, directions, Marching(), np.random.default_rng(seed))
        return weights(laplace_density(_distance(origins, directions, found), BETA), found.length).sum(dim=1)

    assert torch.equal(alpha(1), alpha(1)) and not torch.equal(alpha(1), alpha(2))
    assert float(alpha(3).mean()) == pytest.approx(_closed(0.0297), abs=2e-2)


def test_rays_beside_the_box_and_from_within_it_are_told_apart(shell: Shell) -> None:
    origins = torch.stack([CENTRE - torch.tensor([0.0, 0.0, RADIUS + 5e-3]), CENTRE + torch.tensor([1.0, 0.0, 0.0])])
    directions = torch.tensor([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    found = through(shell, origins, directions, Marching())
    assert found.ray.tolist() == [0] and found.middle.min() > 0.0 and found.total == 2
    assert not len(through(shell, origins[1:], directions[1:], Marching()).ray)


@pytest.mark.parametrize("name", ["step", "samples", "softness"])
def test_nonsense_is_refused(name: str) -> None:
    with pytest.raises(InputError, match=name):
        replace(Marching(), **{name: 0})
