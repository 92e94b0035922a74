"""Adam by torch's function of it: the first `torch.optim.Adam` of a process loads torch's compiler, for 1.5 s."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor
from torch.optim.adam import adam


class Adam:
    """Adam (Kingma and Ba, ICLR 2015) on parameters: equal to `torch.optim.Adam` bit for bit.

    `rate` and `betas` are those of the next step. `moments` holds what Adam remembers of a parameter, by its number:
    `step` (), and `exp_avg` and `exp_avg_sq` in the shape of the parameter; nothing of one that had no gradient yet.
    `fused` takes the kernel that does a step in one pass over memory.
    """

    def __init__(
        self,
        parameters: Iterable[Tensor],
        rate: float,
        betas: tuple[float, float] = (0.9, 0.999),
        fused: bool = False,
    ) -> None:
        self.parameters = list(parameters)
        self.rate, self.betas = rate, betas
        self.moments: dict[int, dict[str, Tensor]] = {}
        self._fused = fused

    def forget(self) -> None:
        """Drop the gradients."""
        for parameter in self.parameters:
            parameter.grad = None

    @torch.no_grad()
    def step(self, divisor: Tensor | None = None) -> None:
        """Move the parameters that have a gradient; the fused kernel divides it by `divisor` () first."""
        moved = {number: p for number, p in enumerate(self.parameters) if p.grad is not None}
        if not moved:
            return
        for number in moved.keys() - self.moments.keys():
            self.moments[number] = self._nothing(moved[number])
        kept = [self.moments[number] for number in moved]
        adam(
            list(moved.values()),
            [p.grad for p in moved.values() if p.grad is not None],
            [moments["exp_avg"] for moments in kept],
            [moments["exp_avg_sq"] for moments in kept],
            [],
            [moments["step"] for moments in kept],
            fused=self._fused or None,
            grad_scale=divisor,
            found_inf=None if divisor is None else torch.zeros((), device=divisor.device),
            amsgrad=False,
            beta1=self.betas[0],
            beta2=self.betas[1],
            lr=self.rate,
            weight_decay=0.0,
            eps=1e-8,
            maximize=False,
        )

    def _nothing(self, parameter: Tensor) -> dict[str, Tensor]:
        count = torch.zeros((), device=parameter.device if self._fused else None)
        return {"step": count, "exp_avg": torch.zeros_like(parameter), "exp_avg_sq": torch.zeros_like(parameter)}
