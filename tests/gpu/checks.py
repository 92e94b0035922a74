"""Checks on a GPU, in under three minutes: `python tests/gpu/checks.py`, beside the tests, which need none.

Relit frames against the CPU's, a short training of each method that works on a device, and steps a second at three
sizes of texture. Prints one JSON object; exit code 1 if a frame differs, 0 if there is no GPU, which it says.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from handbench.bench import given
from handbench.bench.resolving import Selected, resolve
from handbench.bench.run import find_protocol
from handbench.data.capture import Capture
from handbench.data.openstage import open_capture
from handbench.device import device, on_device
from handbench.method import silent
from handbench.methods import geometry, relightablehands, urhand
from handbench.methods.kit.engine import Player, fit
from handbench.methods.urhand.config import configuration
from handbench.methods.urhand.method import URHand, URHandPrior
from handbench.methods.urhand.model import URHandModel
from handbench.methods.urhand.training import Lesson
from handbench.recording import Recording
from handbench.scene import Array

TEXTURES = (256, 512, 1024)
STEPS = 40
ALLOWED = 1e-4  # of the brightest pixel: sums in another order
DIFFERENCE = "relit frames, greatest difference from the CPU's"


def main() -> int:
    if not torch.cuda.is_available():
        print("no GPU")
        return 0
    told = {"gpu": torch.cuda.get_device_name(), "torch": torch.__version__, **measured("cuda")}
    print(json.dumps(told, indent=1))
    return int(not told[DIFFERENCE] <= ALLOWED)  # NaN is a difference, too


def measured(place: str, textures: Sequence[int] = TEXTURES, steps: int = STEPS) -> dict[str, Any]:
    """All checks on a device by its name."""
    capture = open_capture("mini")
    selected = resolve(find_protocol("smoke"), capture.frames())
    config = configuration("quick")
    torch.manual_seed(0)
    model = URHandModel(config, len(selected.train[0].pose.joints))
    true = _pictures(capture, selected, model)
    model.to(place)
    with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
        exact = _pictures(capture, selected, model)
    told = {DIFFERENCE: _apart(exact, true)}
    told["the same with convolutions in TF32, as torch has it"] = _apart(_pictures(capture, selected, model), true)
    with on_device(place):
        told["short trainings, seconds"] = _trainings(capture, selected)
        told["training steps a second"] = {str(size): _rate(capture, selected, size, steps) for size in textures}
    return told


def _pictures(capture: Capture, selected: Selected, model: URHandModel) -> list[Array]:
    """One frame of each kind of one subject, by URHand with this model where it is."""
    frames = {f.kind: f for column in selected.scored.values() for f in column}
    subject = next(iter(frames.values())).subject
    prior = URHandPrior(model, len(selected.train[0].pose.joints))
    avatar = prior.personalise(given.enrolment(selected, URHand(model.config).info, subject, capture.observe))
    return [avatar.relight(f.query).image.astype(np.float64) for f in frames.values() if f.subject == subject]


def _apart(found: list[Array], true: list[Array]) -> float:
    """The largest difference, relative to each picture's brightest pixel."""
    return max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in zip(found, true, strict=True))


def _trainings(capture: Capture, selected: Selected) -> dict[str, float]:
    """Seconds of trainings of a few steps, set up included; each raises where a tensor is in the wrong place."""
    one, few = _one_subject(capture, selected), {"steps": "3"}
    trained = {
        "urhand": lambda: urhand.create("smoke", changes=few).train(one),
        "relightablehands": lambda: relightablehands.create("smoke", few).train(one).personalise(one),
        "geometry": lambda: geometry.create("smoke", few).train(one),
    }
    seconds = {}
    for name, train in trained.items():
        start = time.perf_counter()
        train()
        seconds[name] = round(time.perf_counter() - start, 1)
    return seconds


def _rate(capture: Capture, selected: Selected, size: int, steps: int) -> float:
    """URHand's training steps a second, with the discriminator; the first few, which load and choose kernels, apart."""
    config = replace(configuration("quick"), texture=size)
    model = URHandModel(config, len(selected.train[0].pose.joints)).to(device())
    lesson = Lesson(model, _one_subject(capture, selected))
    players = [Player("generator", model, lesson.losses)]
    if lesson.discriminator is not None:
        players.append(Player("discriminator", lesson.discriminator, lesson.adversary))
    for budget in (replace(config.budget, steps=max(1, steps // 4)), replace(config.budget, steps=steps)):
        _wait()
        start = time.perf_counter()
        fit("urhand", players, len(lesson.views), budget, 0, silent)
        _wait()
    return round(steps / (time.perf_counter() - start), 2)


def _wait() -> None:
    """Until the device has done what it was given."""
    if torch.cuda.is_available():
        torch.cuda.synchronize()


def _one_subject(capture: Capture, selected: Selected) -> Recording:
    frames = given.training(selected, capture.observe).frames
    return Recording([f for f in frames if f.subject == frames[0].subject], capture.observe)


if __name__ == "__main__":
    sys.exit(main())
