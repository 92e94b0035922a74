"""A cost near a state: what terms add to."""

from __future__ import annotations

from dataclasses import dataclass

from ...scene import Array


@dataclass
class Quadratic:
    """A cost near a state, and its quadratic model in the steps of a picture's hand and of the shape together."""

    cost: float
    gradient: Array
    hessian: Array

    def add(self, cost: float, weight: Array, off: Array, by: Array) -> None:
        """Add weighted squares: residuals (n,) that move by (n, P)."""
        self.cost += cost
        weighted = by * weight[:, None]
        self.gradient += weighted.T @ off
        self.hessian += weighted.T @ by
