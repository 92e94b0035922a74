"""Time against size: lights, texels, subjects and frames, each with the exponent of its growth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import cycle, islice
from statistics import median
from typing import Any

import numpy as np

from ...hand import hand_model
from ...light.environment import rotate
from ...scene import Array, Mesh
from .configurations import Configuration
from .core import Core
from .measure import timed
from .record import PowerLaw, Scaling
from .scene import LEVEL, Scene, moved


def fit(sizes: Sequence[float], seconds: Sequence[float]) -> PowerLaw:
    """The growth over the asymptotic part: sizes from the first that takes twice the shortest time on, three at least.

    What takes a fixed time hides growth at small sizes.
    """
    least = min(seconds)
    start = next((i for i, s in enumerate(seconds) if s >= 2 * least), len(seconds))
    start = max(0, min(start, len(seconds) - 3))
    x, y = np.log(np.asarray(sizes[start:], float)), np.log(np.asarray(seconds[start:], float))
    offset = x - x.mean()
    exponent = float(offset @ y / (offset @ offset))
    constant = float(y.mean() - exponent * x.mean())
    rest = y - constant - exponent * x
    freedom = max(1, len(x) - 2)
    return PowerLaw(
        exponent, float(np.sqrt(rest @ rest / freedom / (offset @ offset))), float(np.exp(constant)), len(x)
    )


def scalings(scene: Scene, quick: bool, progress: Callable[[], None]) -> list[Scaling]:
    """The four axes on a scene, Lambert with hard shadows."""
    lights = (1, 16, 256, 1024, 4096) if quick else (1, 4, 16, 64, 256, 1024, 4096)
    sides = (64, 128, 256, 512) if quick else (64, 128, 256, 512, 1024)
    subjects, frames = ((1, 2, 4), (1, 4, 16, 64)) if quick else ((1, 2, 4, 8, 16), (1, 4, 16, 64, 256))
    repeats = 2 if quick else 3
    people = identities(subjects[-1])
    maps = [rotate(scene.environment, angle) for angle in np.linspace(0.0, 6.0, 16)]
    found = []

    def add(axis: str, title: str, sizes: tuple[int, ...], work: Callable[[int], Callable[[Any], Array]]) -> None:
        seconds = []
        for size in sizes:
            one = work(size)
            seconds.append(timed(lambda step: step, one, repeats)[0])
            progress()
        growth = fit(sizes, [median(times) for times in seconds])
        found.append(Scaling(axis, title, sizes, tuple(seconds), growth))

    def of_lights(count: int) -> Callable[[int], Array]:
        core = Core(scene, Configuration(texture=64, lights=count))
        return lambda step: core.new_pose(moved(scene.mesh, step))

    def of_texels(texels: int) -> Callable[[int], Array]:
        core = Core(scene, Configuration(texture=round(texels**0.5), lights=16))
        return lambda step: core.new_pose(moved(scene.mesh, step))

    def of_subjects(count: int) -> Callable[[int], Array]:
        core = Core(scene, Configuration(texture=128, lights=16))
        return lambda step: [core.new_pose(moved(mesh, step)) for mesh in people[:count]][-1]

    def of_frames(count: int) -> Callable[[int], Array]:
        known = Core(scene, Configuration(texture=128, lights=(16, 32))).learn(scene.mesh)
        return lambda step: [known.picture(one) for one in islice(cycle(maps), count)][-1]

    add("lights", "Lights, new pose at 64² texels", lights, of_lights)
    add("texels", "Texels, new pose under 16 lights", tuple(side * side for side in sides), of_texels)
    add("subjects", "Subjects, a new pose each", subjects, of_subjects)
    add("frames", "Frames of a known pose, a 16 × 32 map each", frames, of_frames)
    return found


def identities(count: int) -> list[Mesh]:
    """Hands of different people in one pose."""
    hand, rng = hand_model(), np.random.default_rng(1)
    pose = hand.sample_pose(np.random.default_rng(3), 0.8)
    return [hand.mesh(hand.sample_identity(rng), pose, LEVEL) for _ in range(count)]
