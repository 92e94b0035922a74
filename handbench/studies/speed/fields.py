"""Encodings of implicit hands: error against time of one network on the signed distance of a hand at rest."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ...hand import hand_model
from ...method import Progress, silent
from ...methods.kit.adam import Adam
from ...methods.palm.config import PRESETS, PalmConfig
from ...methods.palm.model import Conditions, PalmModel
from ...render.volume import Shell
from .record import ImplicitPart, PartTrial

REACH = 6e-3
"""Metres around the skin in which a distance is learned."""

_NEAR, _FAR, _TESTED = 3072, 1024, 20_000  # places of a step near the skin and anywhere, and of an error near it
_RATE = (5e-3, 5e-4)
_SCALE = 5e-3  # metres that cost one
_QUICK = replace(PRESETS["quick"], beta=3e-4)

VARIANTS: Mapping[str, PalmConfig] = {
    "dense grids and tri-plane": _QUICK,
    "hash grid, 8 levels of 2^14": replace(_QUICK, encoding="hash"),
    "hash grid, 12 levels of 2^16": replace(_QUICK, encoding="hash", levels=12, finest=1024.0, table=16),
}


@dataclass(frozen=True, eq=False)
class DistanceSamples:
    """Places (N, 3) about the neutral hand at rest, their signed distances (N,), and which are within `REACH`, (M,)."""

    places: Tensor
    distances: Tensor
    near: Tensor

    @staticmethod
    def of_neutral() -> DistanceSamples:
        hand = hand_model()
        mesh = hand.mesh(hand.neutral(), hand.named_pose("rest"), 2)
        shell = Shell.around(mesh.vertices, mesh.topology.faces, 8e-3, 2e-3)
        distances = shell.distance[:, 0]
        return DistanceSamples(shell.lattice.nodes(), distances, (distances.abs() < REACH).nonzero()[:, 0])

    def some(self, count: int, rows: torch.Generator, far: int = 0) -> tuple[Tensor, Tensor]:
        """`count` of the places near the skin and `far` anywhere, drawn, and their distances."""
        near = self.near[torch.randint(len(self.near), (count,), generator=rows)]
        chosen = torch.cat([near, torch.randint(len(self.places), (far,), generator=rows)])
        return self.places[chosen], self.distances[chosen]


def conditions(model: PalmModel) -> Conditions:
    """What the fields are told of the model's first person at rest."""
    shape = torch.tensor(np.asarray(model.hand.neutral())).float()
    return model.conditions(model.codes(0), shape, torch.zeros(len(model.hand.parents), 3))


def learned(
    name: str, config: PalmConfig, skin: DistanceSamples, steps: int, progress: Progress = silent
) -> tuple[PalmModel, ImplicitPart]:
    """A model whose geometry has learned the skin in `steps` steps, and its mean error in millimetres on the way."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        model = PalmModel(config, hand_model(), 1)
    rows = torch.Generator().manual_seed(1)
    test, expected = skin.some(_TESTED, rows)
    adam = Adam(model.geometry_field.parameters(), _RATE[0], betas=(0.9, 0.99))
    found, spent = [], 0.0
    for step in range(1, steps + 1):
        begin = time.process_time()
        _step(model, adam, *skin.some(_NEAR, rows, _FAR), share=step / steps)
        spent += time.process_time() - begin
        if step in (steps // 8, steps // 4, steps // 2, steps):
            with torch.no_grad():
                error = (model.geometry(test, conditions(model)).sdf - expected).abs().mean()
            found.append(PartTrial(f"{step} steps", step, 1e3 * float(error), spent))
        progress(step, steps)
    return model, ImplicitPart(name, tuple(found))


def _step(model: PalmModel, adam: Adam, places: Tensor, distances: Tensor, share: float) -> None:
    """One step towards distances at places, with the eikonal term, at the rate of a share of the run."""
    found = model.geometry(places, conditions(model), gradient=True)
    assert found.gradient is not None
    loss = ((found.sdf - distances) / _SCALE).abs().mean() + 0.1 * (found.gradient.norm(dim=1) - 1.0).square().mean()
    adam.forget()
    loss.backward()
    adam.rate = _RATE[0] * (_RATE[1] / _RATE[0]) ** share
    adam.step()


def step_of(config: PalmConfig, skin: DistanceSamples) -> tuple[int, float]:
    """Rows of the tables of the geometry's encoding, and the least seconds of CPU of three steps after a first one."""
    model = PalmModel(config, hand_model(), 1)
    adam = Adam(model.geometry_field.parameters(), _RATE[0], betas=(0.9, 0.99))
    rows = torch.Generator().manual_seed(1)
    seconds = []
    for _ in range(4):
        begin = time.process_time()
        _step(model, adam, *skin.some(_NEAR, rows, _FAR), share=0.0)
        seconds.append(time.process_time() - begin)
    return sum(len(table) for table in model.geometry_field.encoding.parameters()), min(seconds[1:])
