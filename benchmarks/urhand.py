"""URHand at texture 128: a training step, and what its networks cost under many lights."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import torch

from handbench.bench.resolving import resolve
from handbench.bench.run import find_protocol
from handbench.light.lightset import LightSet
from handbench.methods.urhand import lighting
from handbench.methods.urhand.config import UrhandConfig, configuration
from handbench.methods.urhand.method import URHand, URHandPrior
from handbench.recording import Recording
from handbench.registry import CAPTURES
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Frame

from .measure import Measurement, seconds, summary

STEPS = 240
PROTOCOLS = {"mini": "smoke", "quick": "quick"}


def urhand(size: str) -> list[Measurement]:
    """Train a few steps on one subject of an openstage capture, generated if missing."""
    capture = CAPTURES.load("openstage")(size)
    selected = resolve(find_protocol(PROTOCOLS[size]), capture.frames())
    subject = selected.train[0].subject
    training = Recording([f for f in selected.train if f.subject == subject], capture.observe)
    config = replace(configuration("quick"), steps=STEPS)
    _, alone = _train(replace(config, adversarial=0.0), training)
    prior, together = _train(config, training)
    return [
        summary("urhand training step, texture 128, no discriminator", "ms", alone, goal=60),
        summary("urhand training step, texture 128, with discriminator", "ms", together, goal=120),
        *_networks(prior, training.frames[0]),
    ]


def _train(config: UrhandConfig, training: Recording) -> tuple[URHandPrior, list[float]]:
    """A prior and the milliseconds of its steps."""
    stamps: list[tuple[int, float]] = []

    def stamp(step: int, total: int, **values: float) -> None:
        stamps.append((step, time.perf_counter()))

    prior = URHand(config).train(training, progress=stamp)
    warm = stamps[1:]  # the first report comes after compilation and the filling of caches
    return prior, [(t1 - t0) / (s1 - s0) * 1e3 for (s0, t0), (s1, t1) in pairwise(warm)]


def _networks(prior: URHandPrior, frame: Frame) -> list[Measurement]:
    """The networks' share of a frame under 1, 32 and 512 white lights: it must not grow with their number."""
    model, found = prior.model, []
    posed = PosedSurface(frame.mesh, model.config.texture)
    texture = torch.rand(3, model.config.texture, model.config.texture)
    with torch.no_grad():
        material = model.material(texture, torch.from_numpy(frame.pose.joints.copy()).float(), posed)
        times: dict[int, list[float]] = {}
        for count in (1, 32, 512):
            towards = np.random.default_rng(0).normal(size=(count, 3))
            towards /= np.linalg.norm(towards, axis=1, keepdims=True)
            lights = LightSet(towards, np.full((count, 3), 1.0 / count), np.zeros((0, 3)), np.zeros((0, 3)))
            surface = (material.normal, material.roughness, posed.position, frame.camera.centre)
            features = lighting.features(model.config, *surface, lights, posed.visibility(lights))
            times[count] = seconds(partial(model.colour, features, lights, material, texture, posed.atlas), 40)[10:]
    for count in (32, 512):
        ratios = [many / one for many, one in zip(sorted(times[count]), sorted(times[1]), strict=True)]
        found.append(summary(f"urhand networks, {count} lights against 1", "", ratios, goal=1.1))
    return found
