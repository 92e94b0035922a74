"""A new pose, and a known pose under a new light: `physical`, `phong` and `urhand` at texture 128.

Every pose that is timed as new is posed afresh, and every light that a known pose is relit by is new to it; each time
is the least of a few. The error is that of the picture under an environment of few lights against the one under every
texel of the map at 16 x 32, which takes so long that few pictures are compared.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import torch

from handbench.data.capture import Capture
from handbench.method import Avatar, Prior
from handbench.methods.reflectance.model import PRESETS, ReflectancePrior
from handbench.methods.urhand.config import configuration
from handbench.methods.urhand.method import URHandPrior
from handbench.methods.urhand.model import URHandModel
from handbench.recording import Recording
from handbench.registry import CAPTURES
from handbench.scene import FRAME_KINDS, Frame
from handbench.tuning import tune

from .measure import Measurement, summary

VIEWPOINTS = 4
ROUNDS = 3
"""Of which the fastest counts."""

COMPARED = (2, 3)
"""Viewpoints, and environments of each, whose pictures are compared with exact ones."""

NEW, KNOWN = {"physical": 90.0, "phong": 90.0, "urhand": 180.0}, {"physical": 25.0, "phong": 25.0, "urhand": 40.0}


def poses(size: str) -> list[Measurement]:
    """Milliseconds and errors on an openstage capture, generated if missing; weights are not trained."""
    tune()  # as a run does
    capture = CAPTURES.load("openstage")(size)
    found = []
    for name, (prior, reference) in priors(len(capture.frames()[0].pose.joints)).items():
        found += _measured(name, prior, reference, capture)
    return found


def priors(joints: int) -> dict[str, tuple[Prior, Prior]]:
    """For each method a prior as it is, and one that draws every texel of an environment."""
    fitted, config = (1.0, 0.3, 0.45), PRESETS["quick"]
    exact = replace(config, environment_error=0.0)
    made: dict[str, tuple[Prior, Prior]] = {
        name: (ReflectancePrior(name, model, config, fitted), ReflectancePrior(name, model, exact, fitted))
        for name, model in (("physical", "brdf"), ("phong", "phong"))
    }
    torch.manual_seed(0)
    settings = configuration("quick")
    models = [URHandModel(each, joints) for each in (settings, replace(settings, environment_error=0.0))]
    models[1].load_state_dict(models[0].state_dict())
    return {**made, "urhand": (URHandPrior(models[0], joints), URHandPrior(models[1], joints))}


def _measured(name: str, prior: Prior, reference: Prior, capture: Capture) -> list[Measurement]:
    views: dict[str, list[Frame]] = {}
    for frame in capture.frames():
        if frame.segment == "held-out":
            views.setdefault(frame.viewpoint.key, []).append(frame)
    chosen = list(views.values())[:: max(1, len(views) // VIEWPOINTS)][:VIEWPOINTS]
    subject = chosen[0][0].subject
    full = Recording([f for f in capture.frames() if f.kind == "full" and f.subject == subject][:4], capture.observe)
    avatar, exact = prior.personalise(full), reference.personalise(full)
    found = []
    for kind in FRAME_KINDS:
        lit = [frames for frames in ([f for f in view if f.kind == kind] for view in chosen) if frames]
        _times(avatar, lit[0])  # what is compiled or kept for all poses
        new, known = zip(*(_least(avatar, frames) for frames in lit), strict=True)
        aimed = kind == "environment"
        found.append(summary(f"{name}, new pose, {kind}", "ms", new, NEW[name] if aimed else None))
        if any(known):
            later = [ms for each in known for ms in each]
            found.append(summary(f"{name}, known pose, new light, {kind}", "ms", later, KNOWN[name] if aimed else None))
        if aimed:
            views_compared, maps = COMPARED
            some = [frames[:maps] for frames in lit[:: max(1, len(lit) // views_compared)][:views_compared]]
            errors = [error for frames in some for error in _errors(avatar, exact, frames)]
            found.append(summary(f"{name}, error under an environment", "%", errors, 1.0))
    return found


def _least(avatar: Avatar, frames: list[Frame]) -> tuple[float, list[float]]:
    """`_times`, each the least of a few rounds."""
    rounds = [_times(avatar, frames) for _ in range(ROUNDS)]
    known = [min(times) for times in zip(*(later for _, later in rounds), strict=True)]
    return min(first for first, _ in rounds), known


def _times(avatar: Avatar, frames: list[Frame]) -> tuple[float, list[float]]:
    """Milliseconds of a new pose, and of the same under each other light of the kind."""
    start = time.perf_counter()
    posed = avatar.pose(frames[0].viewpoint)
    posed.relight(frames[0].light)
    new, known = (time.perf_counter() - start) * 1e3, []
    for frame in frames[1:]:
        start = time.perf_counter()
        posed.relight(frame.light)
        known.append((time.perf_counter() - start) * 1e3)
    return new, known


def _errors(avatar: Avatar, exact: Avatar, frames: list[Frame]) -> list[float]:
    """Errors in per cent of a viewpoint's pictures."""
    ours, truth = (each.pose(frames[0].viewpoint) for each in (avatar, exact))
    return [_error(ours.relight(frame.light).image, truth.relight(frame.light).image) for frame in frames]


def _error(image: np.ndarray, truth: np.ndarray) -> float:
    """Relative RMSE in per cent."""
    apart, size = (float(np.square(each.astype(np.float64)).sum()) for each in (image - truth, truth))
    return 100.0 * (apart / size) ** 0.5


if __name__ == "__main__":
    import sys

    for each in poses(sys.argv[1] if len(sys.argv) > 1 else "quick"):
        print(f"{each.name:45} {each.median:8.2f} {each.unit:3} ({each.least:.2f} to {each.most:.2f})", each.goal or "")
