"""Training of URHand: pictures under random exact combinations of stage lights."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from handbench.errors import NonFinite, Unsupported
from handbench.light.lightset import LightSet, light_samples
from handbench.method import Progress, Recording
from handbench.render.posed import PosedSurface, raster
from handbench.render.raster import Raster
from handbench.scene import Array, Frame

from ..picture import display
from ..reflectance import normalised_texture
from .config import Config
from .model import URHandModel


@dataclass(frozen=True)
class View:
    """One pose of a subject in one camera, with the pictures under every training light.

    pixels (P,) are the flat indices that truth or tracked mesh cover; images (L, 3, P) float16.
    """

    subject: str
    joints: Tensor
    posed: PosedSurface
    raster: Raster
    centre: Array
    lights: LightSet
    visible: Tensor
    pixels: Tensor
    images: Tensor

    def lit_by(self, weights: Array) -> tuple[LightSet, Tensor, Tensor]:
        """Lights, visibility and picture (3, P) under weights (L,) of the stage lights: exact sums."""
        used = np.flatnonzero(weights)
        irradiance = self.lights.irradiance[used] * weights[used, None]
        lights = LightSet(self.lights.directions[used], irradiance, self.lights.positions, self.lights.intensities)
        picture = torch.einsum("lcp,l->cp", self.images[used].float(), torch.from_numpy(weights[used]).float())
        return lights, self.visible[used], picture


def views(recording: Recording, size: int) -> list[View]:
    """The training views; raises `Unsupported` if there are no single-light frames."""
    groups: dict[tuple[str, str], list[Frame]] = {}
    for frame in recording.of_kind("olat").frames:
        groups.setdefault((frame.pose_key, frame.camera.name), []).append(frame)
    if not groups:
        raise Unsupported("urhand trains on single-light frames, and the training frames have none")
    return [_view(frames, recording, size) for frames in groups.values()]


def _view(frames: list[Frame], recording: Recording, size: int) -> View:
    first = frames[0]
    posed = PosedSurface.of(first.mesh, size)
    drawn = raster(first.mesh, first.camera)
    covered = (recording.observe(first).alpha > 0) | (drawn.alpha > 0)
    pixels = np.flatnonzero(covered)
    images = [recording.observe(frame).image.reshape(-1, 3)[pixels].T.astype(np.float16) for frame in frames]
    samples = [light_samples(frame.light) for frame in frames]
    if any(len(sample.directions) != 1 or len(sample.positions) for sample in samples):
        raise Unsupported(f"urhand trains on distant single lights, and {first.key} has another kind of light")
    lights = LightSet(
        np.concatenate([s.directions for s in samples]),
        np.concatenate([s.irradiance for s in samples]),
        np.zeros((0, 3)),
        np.zeros((0, 3)),
    )
    return View(
        subject=first.subject,
        joints=torch.from_numpy(first.pose.joints.copy()).float(),
        posed=posed,
        raster=drawn,
        centre=first.camera.centre,
        lights=lights,
        visible=posed.visibility(lights),
        pixels=torch.from_numpy(pixels),
        images=torch.from_numpy(np.stack(images)),
    )


def light_weights(config: Config, lights: int, rng: np.random.Generator) -> Array:
    """Random weights (L,) of a few lights, about as bright together as one."""
    count = min(int(rng.choice(config.lights)), lights)
    weights = np.zeros(lights)
    weights[rng.choice(lights, count, replace=False)] = rng.uniform(0.5, 1.5, count) / np.sqrt(count)
    return weights


def train(model: URHandModel, recording: Recording, seed: int, progress: Progress) -> None:
    """Train in place, telling the running mean of the loss.

    Raises `NonFinite` as soon as a step's loss or gradient is not finite: nothing is trained through it.
    """
    config = model.config
    textures = {
        subject: normalised_texture(recording.of_subject(subject), config.texture) for subject in recording.subjects
    }
    stage = views(recording, config.texture)
    rng = np.random.default_rng([17, seed])
    # a short memory of squared gradients: one bad step of the multiplied layers is soon damped
    optimiser = torch.optim.Adam(model.parameters(), lr=config.rate[0], betas=(0.9, 0.99), fused=True)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, lambda step: rate_factor(config, step))
    running = 0.0
    for step, batch in enumerate(_batches(len(stage), config, rng), start=1):
        optimiser.zero_grad(set_to_none=True)
        total = 0.0
        for index in batch:
            view = stage[index]
            loss = view_loss(model, view, textures[view.subject], light_weights(config, len(view.images), rng))
            (loss / len(batch)).backward()
            total += float(loss.detach()) / len(batch)
        norm = torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        if not np.isfinite(total) or not torch.isfinite(norm):
            raise NonFinite(
                f"urhand: step {step} gave loss {total:g} and gradient norm {float(norm):g}; lower the rate"
            )
        optimiser.step()
        schedule.step()
        running = total if step == 1 else 0.98 * running + 0.02 * total
        if step % 20 == 0 or step == config.steps:
            progress(step, config.steps, loss=running)


def rate_factor(config: Config, step: int) -> float:
    """The learning rate of a step over the greatest one: a linear rise, then an exponential fall."""
    fall = (config.rate[1] / config.rate[0]) ** (step / max(1, config.steps - 1))
    return min(1.0, (step + 1) / max(1, config.warmup)) * fall


def _batches(count: int, config: Config, rng: np.random.Generator) -> Iterable[Array]:
    """Indices of views for each step: every view once before any comes again."""
    queue = np.zeros(0, dtype=int)
    for _ in range(config.steps):
        while len(queue) < config.batch:
            queue = np.concatenate([queue, rng.permutation(count)])
        yield queue[: config.batch]
        queue = queue[config.batch :]


def view_loss(model: URHandModel, view: View, texture: Tensor, weights: Array) -> Tensor:
    """Image loss on both branches and L1 regularisation (Eqs. 7 and 9) of one view under one combination of lights."""
    config, atlas = model.config, view.posed.atlas
    lights, visible, truth = view.lit_by(weights)
    material = model.material(texture, view.joints, view.posed)
    features = model.features(material, view.posed, view.centre, lights, visible)
    final, encoded = model.colour(features, material, texture, atlas)
    physical = model.physical_colour(features, texture, atlas)
    maps = atlas.dilate(atlas.scatter(torch.cat([final, physical])))
    pictures = view.raster.sample(maps).flatten(1).index_select(1, view.pixels)
    target = display(truth)
    loss = config.image * (display(pictures[:3]) - target).abs().mean()
    loss = loss + config.physical * (display(pictures[3:]) - target).abs().mean()
    return loss + config.sparsity * sum(code.abs().mean() for code in encoded)
