"""Adam and the rate that falls at a plateau: what torch computes, without what torch loads for it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from handbench.methods.harp.plateau import Plateau
from handbench.methods.kit.adam import Adam
from handbench.methods.kit.engine import Budget, Player, fit


@pytest.fixture
def uncompiled(monkeypatch: pytest.MonkeyPatch) -> None:
    """torch's optimisers with a stand-in for its compiler, which they load and only tell to keep out of the way."""
    stand_in = SimpleNamespace(graph_break=lambda: None, disable=lambda function, *_, **__: function)
    monkeypatch.setitem(sys.modules, "torch._dynamo", stand_in)
    monkeypatch.setattr(torch, "_dynamo", stand_in, raising=False)


def parameters() -> list[nn.Parameter]:
    rng = torch.Generator().manual_seed(3)
    return [nn.Parameter(torch.randn(shape, generator=rng)) for shape in ((5, 7), (3,), (), (2, 3, 4, 4))]


def moved(adam: Any, values: list[nn.Parameter], step: Callable[[int], None]) -> list[torch.Tensor]:
    """The values after steps along gradients that differ in size; the second value has none in the first steps."""
    rng = torch.Generator().manual_seed(4)
    for number in range(12):
        for i, value in enumerate(values):
            gradient = torch.randn(value.shape, generator=rng) * 10.0 ** (i - number % 3)
            value.grad = None if i == 1 and number < 4 else gradient
        step(number)
    return [value.detach().clone() for value in values]


@pytest.mark.parametrize("fused", [False, True])
def test_it_moves_as_the_optimiser_of_torch_to_the_bit(uncompiled: None, fused: bool) -> None:
    rates, divisors = np.geomspace(1e-1, 1e-4, 12), torch.linspace(1.0, 7.0, 12)
    mine, theirs = parameters(), parameters()
    adam = Adam(mine, 1.0, (0.8, 0.99), fused)
    other = torch.optim.Adam(theirs, 1.0, (0.8, 0.99), fused=fused)

    def step(number: int) -> None:
        adam.rate = float(rates[number])
        adam.step(divisors[number] if fused else None)

    def their_step(number: int) -> None:
        other.param_groups[0]["lr"] = float(rates[number])
        if fused:
            other.grad_scale, other.found_inf = divisors[number], torch.zeros(())  # type: ignore[attr-defined]
        other.step()

    found, expected = moved(adam, mine, step), moved(other, theirs, their_step)
    assert all(map(torch.equal, found, expected))
    kept = other.state_dict()["state"]
    assert adam.moments.keys() == kept.keys()
    for number, moments in adam.moments.items():
        assert moments.keys() == kept[number].keys()
        assert all(torch.equal(value, kept[number][name]) for name, value in moments.items())


def test_without_a_gradient_nothing_moves() -> None:
    values = parameters()
    adam = Adam(values, 1.0)
    adam.step()
    assert all(map(torch.equal, values, parameters())) and not adam.moments


def test_a_training_loads_no_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would take longer than everything else that a short training loads."""
    monkeypatch.setitem(sys.modules, "torch._dynamo", None)  # to import it is an error now
    line = nn.Linear(1, 1)
    player = Player("line", line, lambda sample, rng: {"l2": (line(torch.ones(1)) - 3.0).square().sum()})
    fit("line", [player], 1, Budget(steps=100, batch=1, rate=(1e-1, 1e-1)), 0, lambda *_, **__: None)
    assert float(line(torch.ones(1)).detach()) == pytest.approx(3.0, abs=0.05)


@pytest.mark.parametrize("patience", [0, 3, 10])
def test_the_rate_falls_where_that_of_torch_falls(uncompiled: None, patience: int) -> None:
    losses = np.geomspace(10.0, 1.0, 300) + np.random.default_rng(patience).uniform(0.0, 1.0 + patience, 300)
    optimiser = torch.optim.Adam(parameters(), 0.5)
    theirs = torch.optim.lr_scheduler.ReduceLROnPlateau(optimiser, patience=patience)
    mine, rates = Plateau(0.5, patience), []
    for loss in losses:
        theirs.step(float(loss))
        rates.append(mine.after(float(loss)))
        assert rates[-1] == optimiser.param_groups[0]["lr"]
    assert len(set(rates)) > 2
