"""Rows of a tensor, with a gradient that is the same to the bit on every run."""

from __future__ import annotations

from torch import Tensor


def rows_of(values: Tensor, index: Tensor) -> Tensor:
    """The rows (..., C) of values (V, C) at an index (...).

    That is `values[index]`, whose gradient several threads of a CPU sum in any order, and so not to the same bits.
    """
    return values.index_select(0, index.flatten()).unflatten(0, index.shape)
