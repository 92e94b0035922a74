"""Training of RelightableHands on one subject: pictures under random exact sums of recorded ones."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from handbench.device import device
from handbench.errors import Unsupported
from handbench.method import Progress, Recording, silent
from handbench.scene import Array
from handbench.scene.colour import unclipped_srgb

from ..kit.engine import Player, fit, light_weights
from ..kit.host import on_host
from ..kit.perceptual import perceptual_loss
from ..kit.views import TrainingView, views
from .config import RelightableHandsConfig
from .model import NEAREST, RelightableHandsModel, ViewedTexels, lit

_BRIGHT = 0.99  # the share of the hand's values that are darker than 128 of 255


def train(
    config: RelightableHandsConfig, recording: Recording, seed: int = 0, progress: Progress = silent
) -> RelightableHandsModel:
    """The model of the recording's one subject.

    Raises `Unsupported` for a recording without single-light and group frames, `NonFinite` as soon as a step's loss or
    gradient is not finite.
    """
    seen = views(recording, config.texture, method="relightablehands", device=device())
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        model = RelightableHandsModel(config, len(seen[0].joints), exposure(seen)).to(device())
    player = Player("decoder", model, Lesson(model, seen).losses)
    fit(f"relightablehands-{seen[0].subject}", [player], len(seen), config.budget, seed, progress)
    return model.eval()


def exposure(seen: list[TrainingView]) -> float:
    """Twice the radiance that the brightest hundredth of the hand has under a single light of unit irradiance.

    So 255 of Eq. 7 has room for highlights, whatever units a capture's lights and cameras have. A group counts as its
    strongest light: lights from different sides have different brightest places. `Unsupported` if all pictures are
    black.
    """
    bright = []
    for view in seen:
        strongest = _irradiance(view).max(axis=1).astype(np.float32)
        values = on_host(view.images.float().mean(dim=1)) / strongest[:, None, None]
        bright.append(np.quantile(values[:, view.raster.alpha[view.box] > 0.5], _BRIGHT))
    found = 2.0 * float(np.mean(bright))
    if not found > 0.0:
        raise Unsupported("relightablehands trains on pictures under single lights or groups, and all are black")
    return found


def _irradiance(view: TrainingView) -> Array:
    """Mean irradiance over the colours of each light in each picture (L, S), of a near one in the hand's middle."""
    away = np.linalg.norm(view.positions - on_host(view.posed.position.mean(dim=1)), axis=1)
    falloff = np.concatenate([np.ones(len(view.directions)), np.maximum(away, NEAREST) ** -2.0])
    return view.power.mean(axis=2) * falloff


class Lesson:
    """The losses of the model on the views of a subject."""

    def __init__(self, model: RelightableHandsModel, seen: list[TrainingView]) -> None:
        self.model, self.views = model, seen
        self._seen = [ViewedTexels.of(view.posed, view.centre, view.joints) for view in seen]

    def losses(self, sample: int, rng: np.random.Generator) -> Mapping[str, Tensor]:
        """L2, perceptual and negative-colour loss on one view under a random combination of its lights.

        Pictures are compared as displayed (sRGB), as the metrics do.
        """
        config, view = self.model.config, self.views[sample]
        lights, visible, truth = view.lit_by(light_weights(len(view.images), config.lights, rng))
        assert visible is not None  # views are made with shadows
        responses, cut = self.model.responses(self._seen[sample], lights.directions, visible, lights.positions)
        power = np.concatenate([lights.irradiance, lights.intensities])
        drawn, target = unclipped_srgb(view.draw(lit(responses, power))), unclipped_srgb(truth)
        terms = {
            "l2": (drawn - target).square().sum() / (3 * view.covered),
            "negative": config.negative * (cut / 255.0).clamp_max(0.0).square().mean(),
        }
        if config.perceptual:
            terms["perceptual"] = config.perceptual * perceptual_loss(drawn[None], target)[0]
        return terms
