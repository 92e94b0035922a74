"""The lighting core against naive torch, side by side: fused shading, its gradient and memory, and all skips."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from handbench.registry import CAPTURES
from handbench.render.shade.shading import LightSet, light_features, light_samples
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Array, Directional, Frame, Group, Mesh
from handbench.skips import NONE, Skips, skipping
from handbench.studies.speed.naive import naive_features

from .measure import Measurement, seconds, summary

Features = Callable[..., tuple[Tensor, Tensor]]
REPEATS = 7


class ShadingScene:
    """A posed hand at the covered texels of an R x R texture under distant lights, shadows known."""

    def __init__(self, frame: Frame, size: int, lights: int) -> None:
        posed = PosedSurface(frame.mesh, size)
        self.lights = stage(lights, lights)
        self.texels = posed.atlas.count
        roughness = torch.from_numpy(np.random.default_rng(1).uniform(0.3, 0.9, self.texels)).float()
        self.maps = [posed.normal, posed.position, roughness]
        self.rest = (frame.camera.centre, self.lights, posed.visibility(self.lights))

    def forward(self, features: Features) -> None:
        with torch.no_grad():
            features(*self.maps, *self.rest)

    def train(self, features: Features) -> None:
        inputs = [values.clone().requires_grad_() for values in self.maps]
        diffuse, specular = features(*inputs, *self.rest)
        (diffuse.sum() + specular.sum()).backward()


def stage(lights: int, lit: int) -> LightSet:
    """Lights in seeded random directions, of which some are lit."""
    random = np.random.default_rng(0)
    towards = random.normal(size=(lights, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    power = np.zeros((lights, 3))
    power[random.permutation(lights)[:lit]] = random.uniform(0.5, 1.5, (lit, 3))
    return LightSet(towards, power, np.zeros((0, 3)), np.zeros((0, 3)))


def some_frame() -> Frame:
    return CAPTURES.load("openstage")("mini").frames()[0]


def shading() -> list[Measurement]:
    """Forward at texture 256 with 150 lights, forward and backward at 512 with 32, all skips at 256 with 5 of 150."""
    frame = some_frame()
    return [
        *_forward(ShadingScene(frame, 256, 150)),
        *_training(ShadingScene(frame, 512, 32)),
        *_memory(),
        *_skips(frame),
    ]


def _forward(scene: ShadingScene) -> list[Measurement]:
    first = seconds(lambda: scene.forward(light_features), 1)
    fused, naive = _side_by_side(lambda: scene.forward(light_features), lambda: scene.forward(naive_features))
    pairs = scene.texels * len(scene.lights) / 1e6
    return [
        summary("fused shading, 256, 150 lights: first call", "s", first),
        summary("fused shading, 256, 150 lights: 400 million texel-lights", "s", [400 * t / pairs for t in fused], 1.0),
        summary("fused shading, 256, 150 lights: share of naive torch's time", "", _ratios(fused, naive), 1 / 5),
    ]


def _training(scene: ShadingScene) -> list[Measurement]:
    scene.train(light_features)
    ours, naive = _side_by_side(lambda: scene.train(light_features), lambda: scene.train(naive_features), 3)
    name = "forward and backward, 512, 32 lights: share of naive torch's time"
    return [summary("forward and backward, 512, 32 lights", "s", ours), summary(name, "", _ratios(ours, naive), 1 / 3)]


def _memory() -> list[Measurement]:
    ours, naive = (_peak(name) for name in ("light", "naive"))
    name = "forward and backward, 512, 32 lights: share of naive torch's memory"
    return [
        summary("forward and backward, 512, 32 lights: peak memory", "MB", [ours]),
        summary(name, "", [ours / naive], 1 / 4),
    ]


def _peak(which: str) -> float:
    """Megabytes that training takes at most beyond what is resident before it, in a process of its own."""
    code = f"from benchmarks.shading import tell_peak; tell_peak({which!r})"
    told = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, env=dict(os.environ)
    )
    return float(told.stdout)


def tell_peak(which: str) -> None:
    features = {"light": light_features, "naive": naive_features}[which]
    frame = some_frame()
    scene = ShadingScene(frame, 512, 32)
    scene.train(features)  # what allocators and the compiler keep for good is no part of the peak
    status = Path("/proc/self/status")
    Path("/proc/self/clear_refs").write_text("5")  # Linux: starts the peak anew
    before = _kibibytes(status, "VmRSS")
    scene.train(features)
    print((_kibibytes(status, "VmHWM") - before) * 1024 / 1e6)


def _kibibytes(status: Path, field: str) -> int:
    return next(int(line.split()[1]) for line in status.read_text().splitlines() if line.startswith(field))


def _skips(frame: Frame) -> list[Measurement]:
    """Surface maps, shadow rays and shading of a pose seen for the first time, all skips against none."""
    lights = stage(150, 5)
    light = Group(tuple(map(Directional, lights.directions, lights.irradiance)))

    def features(skips: Skips) -> tuple[float, Array]:
        mesh = Mesh(frame.mesh.vertices, frame.mesh.topology)  # nothing is known of it
        with skipping(skips):
            start = time.perf_counter()
            posed = PosedSurface(mesh, 256)
            given = light_samples(light)
            rough = torch.full((posed.atlas.count,), 0.4)
            maps = posed.normal, posed.position, rough
            found = light_features(*maps, frame.camera.centre, given, posed.visibility(given))
            took = time.perf_counter() - start
            return took, torch.stack([posed.atlas.scatter(values) for values in found]).numpy()

    Atlas.of(frame.mesh.topology, 256)  # a capture has one topology: an atlas is made once
    times: dict[bool, list[float]] = {True: [], False: []}
    for _ in range(REPEATS):
        took, ours = features(Skips())
        times[True].append(took)
        took, plain = features(NONE)
        times[False].append(took)
    error = float(np.abs(ours - plain).max() / plain.max())
    name = "all skips, 256, 5 of 150 lights lit"
    return [
        summary(f"{name}: features of a new pose", "s", times[True]),
        summary(f"{name}: share of the time without", "", _ratios(times[True], times[False]), 1 / 8),
        summary(f"{name}: largest difference, of the largest value", "", [error], 1e-6),
    ]


def _side_by_side(
    one: Callable[[], None], other: Callable[[], None], repeats: int = REPEATS
) -> tuple[list[float], list[float]]:
    """Seconds of calls that take turns, so that both see the same machine."""
    pairs = [(seconds(one, 1)[0], seconds(other, 1)[0]) for _ in range(repeats)]
    return [mine for mine, _ in pairs], [theirs for _, theirs in pairs]


def _ratios(ours: list[float], theirs: list[float]) -> list[float]:
    return [mine / other for mine, other in zip(ours, theirs, strict=True)]
