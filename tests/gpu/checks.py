"""Checks on a GPU, in under three minutes: `python tests/gpu/checks.py`, beside the tests, which need none.

A training step, a relit frame against the CPU's, and steps a second at three sizes of texture. Prints one JSON object;
exit code 1 if a check fails, 0 if there is no GPU, which it says.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from handbench.bench import given
from handbench.bench.resolving import Selected, resolve
from handbench.bench.run import find_protocol
from handbench.data.capture import Capture
from handbench.data.openstage import open_capture
from handbench.device import on_device
from handbench.methods.urhand.config import configuration
from handbench.methods.urhand.method import URHand, URHandPrior
from handbench.methods.urhand.model import URHandModel
from handbench.recording import Recording

TEXTURES = (256, 512, 1024)
STEPS = 20
ALLOWED = 1e-4  # of the brightest pixel: sums in another order


def main() -> int:
    if not torch.cuda.is_available():
        print("no GPU")
        return 0
    capture = open_capture("mini")
    selected = resolve(find_protocol("smoke"), capture.frames())
    told: dict[str, Any] = {"gpu": torch.cuda.get_device_name(), "torch": torch.__version__}
    told["relit frame, greatest difference from the CPU's"] = _difference(capture, selected)
    told["training steps a second"] = {str(size): _steps(capture, selected, size) for size in TEXTURES}
    print(json.dumps(told, indent=1))
    return int(told["relit frame, greatest difference from the CPU's"] > ALLOWED)


def _difference(capture: Capture, selected: Selected) -> float:
    """The largest difference, relative to the brightest pixel, over one frame of each kind."""
    frames = {f.kind: f for column in selected.scored.values() for f in column}
    subject = next(iter(frames.values())).subject
    joints = len(selected.train[0].pose.joints)
    config = configuration("quick")
    torch.manual_seed(0)
    model = URHandModel(config, joints)
    pictures = []
    for place in ("cpu", "cuda"):
        prior = URHandPrior(model.to(place), joints)
        enrolment = given.enrolment(selected, URHand(config).info, subject, capture.observe)
        avatar = prior.personalise(enrolment)
        same = [f for f in frames.values() if f.subject == subject]
        pictures.append([avatar.relight(f.query).image.astype(np.float64) for f in same])
    return max(float(np.abs(a - b).max() / np.abs(a).max()) for a, b in zip(*pictures, strict=True))


def _steps(capture: Capture, selected: Selected, size: int) -> float:
    """Training steps a second with the discriminator: what more steps take longer."""
    frames = given.training(selected, capture.observe)
    one = Recording([f for f in frames.frames if f.subject == frames.frames[0].subject], capture.observe)
    seconds = []
    for steps in (STEPS, STEPS, 3 * STEPS):  # the first warms up
        torch.cuda.synchronize()
        start = time.perf_counter()
        with on_device("cuda"):
            URHand(replace(configuration("quick"), texture=size, steps=steps)).train(one)
        torch.cuda.synchronize()
        seconds.append(time.perf_counter() - start)
    return round(2 * STEPS / (seconds[2] - seconds[1]), 2)


if __name__ == "__main__":
    sys.exit(main())
