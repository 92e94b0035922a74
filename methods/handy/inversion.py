"""Inversion: the code whose texture, drawn in the pictures of a person, is like them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import assert_never

import numpy as np
import torch
from torch import Tensor, nn

from handbench.method import Progress
from handbench.scene.colour import unclipped_linear, unclipped_srgb

from ..kit.engine import Budget, Player, fit
from ..kit.perceptual import patch, perceptual_loss
from .config import HandyConfig
from .generator import LAYERS, Generator
from .pictures import DisplayCrop


class Sought(nn.Module):
    """What is sought: the codes (1, K), or (1, LAYERS, K) in w+, and the log of the exposure, (1,) or (3,).

    The exposure begins with what makes the first texture as bright as the pictures that are drawn without their light;
    where there are none, it is of no use and stays.
    """

    def __init__(self, made: Generator, shots: Sequence[DisplayCrop], config: HandyConfig, seed: int) -> None:
        super().__init__()
        self.config = config
        code = _start(made, config, seed)
        if config.space == "w+":
            code = code[:, None].repeat(1, LAYERS, 1)
        self.codes = nn.Parameter(code)
        self._made = [made]  # in a list: its weights are no parameters of this
        ratios = [_ratio(shot, self.albedo().detach()) for shot in shots if shot.diffuse is None]
        ratio = torch.stack(ratios).mean(dim=0) if ratios else torch.ones(3)
        exposure = (ratio if config.exposure == "colour" else ratio.mean(dim=0, keepdim=True)).log()
        self.exposure = nn.Parameter(exposure, requires_grad=bool(ratios))

    def albedo(self) -> Tensor:
        """The texture (3, SIZE, SIZE), linear, never negative."""
        made = self._made[0]
        match self.config.space:
            case "pca":
                drawn = made.linear(self.codes)
            case "w" | "w+":
                drawn = made(self.codes)
            case _:
                assert_never(self.config.space)
        return unclipped_linear(drawn[0])


def inverted(
    made: Generator, shots: Sequence[DisplayCrop], config: HandyConfig, seed: int, progress: Progress
) -> tuple[Tensor, Tensor]:
    """The albedo (3, SIZE, SIZE), linear, and the exposure (1,) or (3,) of pictures drawn without their light.

    Adam on the mean absolute difference of display values inside the masks, of a few pictures a step, as they are drawn
    with the current texture (URHand supp. Sec. 5.1). Raises `NonFinite` if it breaks.
    """
    sought = Sought(made, shots, config, seed)
    budget = Budget(config.steps, 1, config.rate)
    losses = _Losses(sought, shots, config)
    fit("handy", [Player("codes", sought, losses.of)], 1, budget, seed, progress)
    return sought.albedo().detach(), sought.exposure.detach().exp()


class _Losses:
    def __init__(self, sought: Sought, shots: Sequence[DisplayCrop], config: HandyConfig) -> None:
        self._sought, self._shots, self._config = sought, shots, config

    def of(self, _: int, rng: np.random.Generator) -> Mapping[str, Tensor]:
        """The terms of some pictures that `rng` draws, and of the code."""
        sought, config = self._sought, self._config
        albedo, exposure = sought.albedo(), sought.exposure.exp()
        count = min(config.batch, len(self._shots))
        colour, features = torch.zeros(()), torch.zeros(())
        for i in rng.choice(len(self._shots), count, replace=False):
            shot = self._shots[i]
            drawn = unclipped_srgb(shot.drawn(albedo, exposure).clamp_min(0.0))
            colour = colour + (drawn - shot.image)[:, shot.inside].abs().mean() / count
            if config.features:
                where = _around(shot.inside, rng)
                both = (torch.where(shot.inside[where], image[:, *where], 0.0) for image in (drawn, shot.image))
                features = features + perceptual_loss(next(both)[None], next(both))[0] / count
        return {
            "colour": colour,
            "features": config.features * features,
            "prior": config.prior / len(self._shots) * sought.codes.square().mean(),
        }


def _around(inside: Tensor, rng: np.random.Generator) -> tuple[slice, slice]:
    """A random patch of the box of what is inside."""
    rows, columns = (torch.nonzero(inside.any(dim=axis)).flatten() for axis in (1, 0))
    top, left = int(rows[0]), int(columns[0])
    chosen = patch(int(rows[-1]) + 1 - top, int(columns[-1]) + 1 - left, rng)
    return slice(top + chosen[0].start, top + chosen[0].stop), slice(left + chosen[1].start, left + chosen[1].stop)


def _start(made: Generator, config: HandyConfig, seed: int) -> Tensor:
    match config.start:
        case "mean":
            return torch.zeros(1, made.code)
        case "random":
            return made.map(torch.randn(1, made.code, generator=torch.Generator().manual_seed(seed)))
        case _:
            assert_never(config.start)


def _ratio(shot: DisplayCrop, albedo: Tensor) -> Tensor:
    """Mean linear colour (3,) of a picture over that of the texture drawn in it."""
    drawn = shot.raster.sample(albedo)[:, shot.inside].mean(dim=1)
    return unclipped_linear(shot.image)[:, shot.inside].mean(dim=1).clamp_min(1e-4) / drawn.clamp_min(1e-4)
