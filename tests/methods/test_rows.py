"""Rows of a tensor have gradients that do not depend on which thread came first."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch

from handbench.methods.kit.rows import rows_of


@pytest.fixture
def two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def test_rows_and_their_gradient_are_those_of_brackets_but_the_same_to_the_bit(two_threads: None) -> None:
    generator = torch.Generator().manual_seed(0)
    values = torch.rand(2000, 3, generator=generator)
    index = torch.randint(0, 2000, (20_000, 3), generator=generator)  # enough for torch to share out among threads
    weights = torch.rand(20_000, 3, 3, generator=generator)

    def gradient(exactly: torch.dtype = torch.float32) -> torch.Tensor:
        given = values.to(exactly).requires_grad_()
        found = rows_of(given, index)
        assert torch.equal(found, given[index])
        return torch.autograd.grad((found * weights.to(exactly)).sum(), given)[0]

    first = gradient()
    assert all(torch.equal(gradient(), first) for _ in range(10))
    assert (first - gradient(torch.float64)).abs().max() < 1e-4 * first.abs().max()
