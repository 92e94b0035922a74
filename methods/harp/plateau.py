"""A rate that falls when the loss does not."""

from __future__ import annotations

import math

_LEAST = 1e-4  # share of the best loss by which a loss must be below it to count as progress
_FALL = 0.1  # what the rate is multiplied by
_SMALLEST = 1e-8  # a fall by less is none


class Plateau:
    """A rate that falls to a tenth after more than `patience` losses in a row without progress.

    By the rule and the defaults of `torch.optim.lr_scheduler.ReduceLROnPlateau`.
    """

    def __init__(self, rate: float, patience: int) -> None:
        self._rate, self._patience = rate, patience
        self._best, self._waited = math.inf, 0

    def after(self, loss: float) -> float:
        """The rate after one more loss."""
        if loss < self._best * (1.0 - _LEAST):
            self._best, self._waited = loss, 0
        else:
            self._waited += 1
        if self._waited > self._patience:
            self._waited = 0
            fallen = self._rate * _FALL
            if self._rate - fallen > _SMALLEST:
                self._rate = fallen
        return self._rate
