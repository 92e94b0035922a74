"""Training of URHand: random exact sums of pictures under known lights, and an adversary that judges them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from handbench.errors import Unsupported
from handbench.light.lightset import LightSet
from handbench.method import Progress, Recording
from handbench.render.shade.shading import light_features
from handbench.scene import Array
from handbench.scene.colour import unclipped_srgb

from ..kit.discriminator import Discriminator, discriminator_loss, generator_loss
from ..kit.engine import Player, fit, light_weights
from ..kit.perceptual import patch, perceptual_loss
from ..kit.views import TrainingView, views
from ..reflectance.model import normalised_texture
from . import lighting
from .model import RefinedMaps, URHandModel

_CONDITIONS = 2  # Phong's diffuse and specular shading, mean of the colours


def train(model: URHandModel, recording: Recording, seed: int, progress: Progress) -> None:
    """Train in place, telling the running means of the losses.

    Raises `NonFinite` as soon as a step's loss or gradient is not finite, `Unsupported` for a recording without
    single-light and group frames, and for near lights where the configuration has none.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        lesson = Lesson(model, recording)
    players = [Player("generator", model, lesson.losses)]
    if lesson.discriminator is not None:
        players.append(Player("discriminator", lesson.discriminator, lesson.adversary))
    fit("urhand", players, len(lesson.views), model.config.budget, seed, progress)


class Lesson:
    """The losses of the model, and of its discriminator where there is one, on the views of a recording."""

    def __init__(self, model: URHandModel, recording: Recording) -> None:
        config = model.config
        self.model, self.config = model, config
        self.textures = {
            s: normalised_texture(recording.of_subject(s), config.texture).to(model.device) for s in recording.subjects
        }
        self.views = views(recording, config.texture, config.shadows, device=model.device)
        near = [view.subject for view in self.views if len(view.positions)]
        if near and not config.near_lights:
            raise Unsupported(
                f"urhand with encoder {config.encoder!r}, shading {config.shading!r} and exposure {config.exposure} "
                f"trains on distant lights only, and frames of {near[0]} have near ones"
            )
        self.discriminator: Discriminator | None = None
        if config.adversarial:
            # after the generator's networks and from the same seed: an ablation without it starts them alike
            self.discriminator = Discriminator(_CONDITIONS if config.light_aware else 0)
            self.discriminator.to(model.device)
        self._shown: tuple[Tensor, Tensor, Tensor | None]

    def losses(self, sample: int, rng: np.random.Generator) -> Mapping[str, Tensor]:
        """The terms of Eq. 7 on a random sum of one view's pictures."""
        config, view = self.config, self.views[sample]
        weights = light_weights(len(view.images), config.lights, rng)
        lights, visible, truth = view.lit_by(weights)
        texture, atlas = self.textures[view.subject], view.posed.atlas
        material = self.model.material(texture, view.joints, view.posed)
        features = self._features(view, material.normal, material.roughness, lights, visible)
        final, encoded = self.model.colour(features, lights, material, texture, atlas)
        pictures = [final, self.model.physical_colour(features, texture, atlas)] if config.neural else [final]
        drawn = unclipped_srgb(view.draw(torch.cat(pictures))).unflatten(0, (-1, 3))
        target = unclipped_srgb(truth)
        terms = self._image_terms(view, drawn, target, rng)
        if encoded:
            terms["sparsity"] = config.sparsity * torch.stack([code.float().abs().mean() for code in encoded]).sum()
        if self.discriminator is not None:
            condition = self._condition(view, lights, visible) if config.light_aware else None
            self._shown = (target[None], drawn[:1], condition)
            terms["adversarial"] = config.adversarial * generator_loss(self.discriminator(drawn[:1], condition))
        if config.consistency and rng.integers(config.consistency_every) == 0:
            other = light_weights(len(view.images), config.lights, rng)
            terms["consistency"] = config.consistency * self._inconsistency(view, material, features, other, rng)
        return terms

    def adversary(self, sample: int, rng: np.random.Generator) -> Mapping[str, Tensor]:
        """The discriminator's loss on the picture that `losses` has just drawn, and its truth."""
        assert self.discriminator is not None
        real, drawn, condition = self._shown
        scores = self.discriminator(torch.cat([real, drawn.detach()]), condition)
        return {"hinge": discriminator_loss([s[:1] for s in scores], [s[1:] for s in scores])}

    def _features(
        self, view: TrainingView, normal: Tensor, roughness: Tensor, lights: LightSet, visible: Tensor | None
    ) -> Tensor:
        return lighting.features(self.config, normal, roughness, view.posed.position, view.centre, lights, visible)

    def _image_terms(
        self, view: TrainingView, drawn: Tensor, target: Tensor, rng: np.random.Generator
    ) -> dict[str, Tensor]:
        """L1 and perceptual loss of the final picture and, weighted, of the physical branch's.

        The perceptual loss looks at a random patch of one of the pictures: its gradient is that of all on average.
        """
        config = self.config
        difference = (drawn - target).abs()
        if config.focus:
            difference = difference * difference.detach().exp()
        l1 = difference.sum(dim=(1, 2, 3)) / (3 * view.covered)
        weights = l1.new_tensor([1.0, config.physical][: len(drawn)])
        terms = {"l1": weights @ l1}
        if config.perceptual:
            rows, columns = patch(target.shape[1], target.shape[2], rng)
            one = int(rng.integers(len(drawn)))
            (loss,) = perceptual_loss(drawn[one : one + 1, :, rows, columns], target[:, rows, columns])
            terms["perceptual"] = config.perceptual * len(drawn) * weights[one] * loss
        return terms

    def _condition(self, view: TrainingView, lights: LightSet, visible: Tensor | None) -> Tensor:
        """Phong's diffuse and specular shading of the light on the coarse surface, (1, 2, h, w)."""
        rough = torch.ones(view.posed.atlas.count, device=view.images.device)
        shaded = light_features(view.posed.normal, view.posed.position, rough, view.centre, lights, visible, "phong")
        return view.draw(torch.stack([kind.mean(dim=0) for kind in shaded]))[None]

    def _inconsistency(
        self, view: TrainingView, material: RefinedMaps, features: Tensor, weights: Array, rng: np.random.Generator
    ) -> Tensor:
        """How far the network is from linear (supp. Eq. 8), root mean square over gain and bias."""
        lights, visible, _ = view.lit_by(weights)
        other = self._features(view, material.normal, material.roughness, lights, visible)
        a, b = rng.uniform(0.0, 1.0, 2)

        def response(values: Tensor) -> Tensor:
            gain, bias, _ = self.model.response(values, lights, material, view.posed.atlas)
            return torch.cat([gain, bias])

        apart = a * response(features) + b * response(other) - response(a * features + b * other)
        return apart.square().mean().clamp_min(1e-16).sqrt()
