"""A pose that knows what it answers to the cells of environments draws what others draw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from handbench.light.lightset import LightSet, light_samples
from handbench.render.shade import cells
from handbench.render.shade.cells import CellAnswers
from handbench.render.shade.models import Model
from handbench.render.shade.shading import light_features
from handbench.scene import Directional, Environment, Group, Point
from handbench.skips import Skips, skipping, tallied

TEXELS = 300


def environment(seed: int) -> Environment:
    """Some light everywhere and, for texels that are lights of their own, a few that are bright."""
    random = np.random.default_rng(seed)
    return Environment(f"map {seed}", random.random((16, 32, 3)) * (1.0 + 50.0 * (random.random((16, 32, 1)) > 0.99)))


def samples(*leaves: Environment | Directional | Point) -> LightSet:
    return light_samples(Group(leaves), environment_error=0.0025)


SUN = Directional(np.array([0.0, 0.6, 0.8]), np.array([1.0, 2.0, 3.0]))
LAMP = Point(np.array([0.3, 0.2, 0.9]), np.array([1.0, 0.5, 0.2]))
HALF = Environment("half", environment(3).radiance * (np.arange(16) < 8)[:, None, None])  # some cells are dark
LIT = (
    samples(HALF),
    samples(environment(0)),
    samples(SUN),
    samples(environment(1), SUN, environment(2), LAMP),
    samples(environment(2)),
)


@pytest.fixture(scope="module")
def maps() -> tuple[Tensor, ...]:
    generator = torch.Generator().manual_seed(0)
    normal, position = torch.randn(2, 3, TEXELS, generator=generator)
    return torch.nn.functional.normalize(normal, dim=0), 0.05 * position, torch.rand(TEXELS, generator=generator)


def seen(lights: LightSet) -> Tensor:
    """Shadows that depend on the light and the texel alone."""
    where = np.concatenate([lights.directions, lights.positions])
    return torch.from_numpy(np.sin(40.0 * where @ np.ones((3, 1)) + np.arange(TEXELS)) > -0.3)


@pytest.mark.parametrize("model", ["brdf", "phong", "diffuse"])
def test_features_are_those_of_shading(maps: tuple[Tensor, ...], model: Model) -> None:
    centre = np.array([0.0, 0.0, 1.0])
    answers = CellAnswers(*maps, centre, model)
    for lights in LIT:
        found = answers.features(lights, seen)
        for ours, plain in zip(found, light_features(*maps, centre, lights, seen(lights), model), strict=True):
            assert (ours - plain).abs().max() <= 2e-6 * plain.abs().max()
    unshadowed = CellAnswers(*maps, centre, model)
    for lights in LIT:
        found = unshadowed.features(lights, lambda _: None)
        for ours, plain in zip(found, light_features(*maps, centre, lights, None, model), strict=True):
            assert (ours - plain).abs().max() <= 2e-6 * plain.abs().max()


def test_cells_are_asked_once(maps: tuple[Tensor, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def counted(*arguments: object) -> Tensor:
        asked.append(len(arguments[4]))  # type: ignore[arg-type]
        return transfer(*arguments)  # type: ignore[arg-type]

    transfer = cells.transfer
    monkeypatch.setattr(cells, "transfer", counted)
    answers = CellAnswers(*maps, np.array([0.0, 0.0, 1.0]), "brdf")
    counts = [int(lights.coarse.sum()) for lights in (LIT[0], LIT[1])]
    assert counts[0] < counts[1] <= 96
    answers.features(LIT[0], seen)
    assert asked == []  # one environment alone is not worth it
    answers.features(replace(LIT[0], irradiance=2.0 * LIT[0].irradiance), seen)
    assert asked == [counts[0]]
    answers.features(LIT[1], seen)
    assert asked == [counts[0], counts[1] - counts[0]]  # those that were dark before
    for lights in LIT:  # one of them has each cell twice
        answers.features(lights, seen)
    assert sum(asked) <= 96
    before = list(asked)
    with tallied() as tally:
        answers.features(LIT[1], seen)
        answers.features(LIT[3], seen)
    saved = tally.lines()["texel-light pairs"].skipped
    assert asked == before and saved >= (counts[1] + int(LIT[3].coarse.sum())) * TEXELS
    forgetful = CellAnswers(*maps, np.array([0.0, 0.0, 1.0]), "brdf")
    with skipping(Skips(known=False)):
        forgetful.features(LIT[0], seen)
        forgetful.features(LIT[1], seen)
    assert asked == before
