"""Training of every learned method: seeded, resumable bit for bit, stopped at the first value that is not finite.

A training has one or more players (a generator alone, or a generator and a discriminator). Each step draws a batch
of samples; for each sample every player in turn gives its weighted losses, whose gradients go to its own parameters
only; then every player takes an Adam step. What a sample is drawn with depends on the seed and its number alone, so
a step can be repeated without the steps before it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any, TypeAlias

import numpy as np
import torch
from torch import Tensor, nn

from handbench.errors import InputError, NonFinite
from handbench.method import Progress
from handbench.scene import Array
from handbench.tuning import tune

from .adam import Adam
from .checkpoint import Checkpoint

Losses: TypeAlias = Callable[[int, np.random.Generator], Mapping[str, Tensor]]

_TELL = 20  # steps between two reports of the losses
_MEMORY = 0.98  # of the running means that are reported
_CLIP = 1.0  # greatest norm of a step's gradient


@dataclass(frozen=True)
class Budget:
    """How long and how fast: Adam's rate rises linearly over `warmup` steps and falls exponentially from rate[0] to
    rate[1] at the last of `steps` steps, each of `batch` samples."""

    steps: int
    batch: int
    rate: tuple[float, float]
    warmup: int = 0
    betas: tuple[float, float] = (0.9, 0.999)

    def __post_init__(self) -> None:
        for name, value in (("steps", self.steps), ("batch", self.batch)):
            if value < 1:
                raise InputError(f"training: {name} is {value}; give at least 1")
        if not 0.0 < self.rate[1] <= self.rate[0]:
            raise InputError(f"training: rate {self.rate} must fall from a positive first value to a positive last one")

    def rate_at(self, step: int) -> float:
        """The learning rate of a step, counted from 0."""
        fall = (self.rate[1] / self.rate[0]) ** (step / max(1, self.steps - 1))
        return self.rate[0] * min(1.0, (step + 1) / max(1, self.warmup)) * fall


@dataclass(frozen=True)
class Player:
    """Networks that minimise losses of their own: `losses(sample, rng)` gives named terms, already weighted."""

    name: str
    module: nn.Module
    losses: Losses

    @property
    def parameters(self) -> list[nn.Parameter]:
        return [p for p in self.module.parameters() if p.requires_grad]


class _Optimiser:
    """Adam on the parameters of a player, taken in the order of memory: the fused kernel copies anything else."""

    def __init__(self, player: Player, budget: Budget) -> None:
        self._parameters = player.parameters
        self._aliases = [nn.Parameter(_in_memory_order(p.detach())) for p in self._parameters]
        self.adam = Adam(self._aliases, budget.rate[0], budget.betas, fused=True)
        self._excess: Tensor

    def forget(self) -> None:
        for parameter in self._parameters:
            parameter.grad = None

    def norm(self) -> float:
        """The norm of the gradient; a step takes it divided by what it exceeds `_CLIP` by."""
        for parameter, alias in zip(self._parameters, self._aliases, strict=True):
            alias.grad = None if parameter.grad is None else _in_memory_order(parameter.grad)
        norm = torch.nn.utils.get_total_norm([alias.grad for alias in self._aliases if alias.grad is not None])
        # by the kernel that reads the gradient anyway: clip_grad_norm_ is one more pass over all of memory
        self._excess = (norm / _CLIP).clamp_min(1.0)
        return float(norm)

    def step(self, rate: float) -> None:
        self.adam.rate = rate
        self.adam.step(self._excess)


def _in_memory_order(values: Tensor) -> Tensor:
    """A view whose last axis is contiguous, of maps with the channels last; other tensors as they are."""
    if values.ndim == 4 and values.is_contiguous(memory_format=torch.channels_last):
        return values.permute(0, 2, 3, 1)
    return values


@dataclass
class _State:
    """Where a training stands: steps done, running means of the losses, what was told so far."""

    step: int = 0
    means: dict[str, float] = field(default_factory=dict)
    told: list[tuple[int, dict[str, float]]] = field(default_factory=list)

    @staticmethod
    def parse(about: Mapping[str, Any], steps: int) -> _State:
        """The state that a checkpoint tells. Raises `KeyError`, `TypeError` or `ValueError` for one that cannot be."""
        step = about["step"]
        if type(step) is not int or not 0 < step <= steps:
            raise ValueError(f"its step is {step!r} of {steps}")
        told = [(int(at), _finite(values)) for at, values in about["told"]]
        return _State(step, _finite(about["means"]), told)


def _finite(values: Mapping[str, float]) -> dict[str, float]:
    found = {str(name): float(value) for name, value in values.items()}
    if not np.isfinite([*found.values()]).all():
        raise ValueError("its losses hold NaN or infinity")
    return found


def fit(name: str, players: Sequence[Player], samples: int, budget: Budget, seed: int, progress: Progress) -> None:
    """Train the players in place on samples 0 … samples - 1, each once before any comes again.

    Goes on from the checkpoint of the training under way, if there is one. `progress` is told the running mean of
    the sum of the first player's losses ("loss") and of each term; those of others are called "player term".
    Raises `NonFinite` at the first step whose loss or gradient is not finite: nothing is trained through it.
    """
    tune()
    optimisers = [_Optimiser(player, budget) for player in players]
    state = _State()
    parts = {
        player.name: (player.module, optimiser.adam) for player, optimiser in zip(players, optimisers, strict=True)
    }
    checkpoint = Checkpoint.of(name, parts)
    if checkpoint is not None and (kept := checkpoint.read(partial(_State.parse, steps=budget.steps))) is not None:
        state = kept
        for step, values in state.told:
            progress(step, budget.steps, **values)
    while state.step < budget.steps:
        terms = _step(name, players, optimisers, samples, budget, seed, state.step)
        state.step += 1
        for term, value in terms.items():
            state.means[term] = _MEMORY * state.means.get(term, value) + (1.0 - _MEMORY) * value
        if state.step % _TELL == 0 or state.step == budget.steps:
            first = [value for term, value in state.means.items() if " " not in term]
            values = {"loss": sum(first), **(state.means if len(state.means) > 1 else {})}
            state.told.append((state.step, values))
            progress(state.step, budget.steps, **values)
        if checkpoint is not None and checkpoint.due():
            checkpoint.write({"step": state.step, "means": state.means, "told": state.told})


def _step(
    name: str,
    players: Sequence[Player],
    optimisers: Sequence[_Optimiser],
    samples: int,
    budget: Budget,
    seed: int,
    step: int,
) -> dict[str, float]:
    """One step of all players; the losses by "term", or "player term" for players after the first."""
    terms: dict[str, float] = {}
    for optimiser in optimisers:
        optimiser.forget()
    for draw in range(step * budget.batch, (step + 1) * budget.batch):
        rng = np.random.default_rng([17, seed, draw])
        sample = int(_order(samples, seed, draw // samples)[draw % samples])
        for i, player in enumerate(players):
            losses = player.losses(sample, rng)
            total = torch.stack(list(losses.values())).sum() / budget.batch
            total.backward(inputs=player.parameters)
            for term, value in losses.items():
                key = term if i == 0 else f"{player.name} {term}"
                terms[key] = terms.get(key, 0.0) + float(value.detach()) / budget.batch
    norms = [optimiser.norm() for optimiser in optimisers]
    if not np.isfinite([*terms.values(), *norms]).all():
        told = ", ".join(f"{term} {value:g}" for term, value in terms.items())
        size = " and ".join(f"{norm:g}" for norm in norms)
        raise NonFinite(f"{name}: step {step + 1} gave {told} and gradients of norm {size}; lower the rate")
    for optimiser in optimisers:
        optimiser.step(budget.rate_at(step))
    return terms


@lru_cache(maxsize=8)
def _order(samples: int, seed: int, epoch: int) -> Array:
    return np.random.default_rng([11, seed, epoch]).permutation(samples)


def light_weights(pictures: int, counts: Sequence[int], rng: np.random.Generator) -> Array:
    """Random weights (pictures,) of a few pictures, `counts` of them as likely each, whose sum is about as bright as
    one."""
    count = min(int(rng.choice(counts)), pictures)
    weights = np.zeros(pictures)
    weights[rng.choice(pictures, count, replace=False)] = rng.uniform(0.5, 1.5, count) / np.sqrt(count)
    return weights
