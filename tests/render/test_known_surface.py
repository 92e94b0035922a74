"""What is kept of lights that are the same for every environment changes no feature."""

from __future__ import annotations

import numpy as np
import torch

from handbench.light.lightset import light_samples
from handbench.render.shade.shading import KnownSurface, light_features
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Environment
from handbench.skips import Skips, skipping


def _map(seed: int) -> Environment:
    return Environment(f"map-{seed}", np.random.default_rng(seed).gamma(0.4, size=(16, 32, 3)))


def test_what_is_known_of_steady_lights_changes_no_feature(shapes) -> None:
    surface = PosedSurface(shapes.sphere(24, 48), 32)
    centre = np.array([0.0, 0.5, 3.0])
    maps = (surface.normal, surface.position, torch.full((surface.atlas.count,), 0.4), centre)
    known = KnownSurface(*maps)
    for seed in (1, 2, 3):
        lights = light_samples(_map(seed), environment_error=0.005)
        visible = surface.visibility(lights)
        expected = light_features(*maps, lights, visible)
        with skipping(Skips(known=False)):
            afresh = known.features(lights, visible)
        for answer in (known.features(lights, visible), afresh):
            for one, other in zip(answer, expected, strict=True):
                assert (one - other).abs().max() < 2e-6 * other.abs().max()
