"""URHand at texture 128: a training step, and a relit frame of a new and of a known pose."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import pairwise

from handbench.bench.protocol import resolve
from handbench.bench.run import find_protocol
from handbench.method import Avatar, Recording
from handbench.methods.urhand.config import configuration
from handbench.methods.urhand.method import URHand
from handbench.registry import CAPTURES
from handbench.scene import Frame

from .measure import Measurement, seconds, summary

STEPS = 240
REPEATS = 15
PROTOCOLS = {"mini": "smoke", "quick": "quick"}


def urhand(size: str) -> list[Measurement]:
    """Train a few steps on one subject of an openstage capture, generated if missing, and relight it."""
    capture = CAPTURES.load("openstage")(size)
    selected = resolve(find_protocol(PROTOCOLS[size]), capture.frames())
    subject = selected.train[0].subject
    training = Recording([f for f in selected.train if f.subject == subject], capture.observe)
    enrolment = Recording([f for f in selected.enrol if f.subject == subject], capture.observe)
    stamps: list[tuple[int, float]] = []

    def stamp(step: int, total: int, **values: float) -> None:
        stamps.append((step, time.perf_counter()))

    method = URHand(replace(configuration("quick"), steps=STEPS))
    prior = method.train(training, progress=stamp)
    warm = stamps[1:]  # the first report comes after compilation and the filling of caches
    steps = [(t1 - t0) / (s1 - s0) * 1e3 for (s0, t0), (s1, t1) in pairwise(warm)]
    avatar = prior.personalise(enrolment)
    frames = {frame.kind: frame for frames in selected.scored.values() for frame in frames if frame.subject == subject}
    relit = [m for kind, frame in sorted(frames.items()) for m in _relight(avatar, kind, frame)]
    return [summary("urhand training step, texture 128", "ms", steps, goal=60), *relit]


def _relight(avatar: Avatar, kind: str, frame: Frame) -> list[Measurement]:
    new = [1e3 * s for s in seconds(lambda: avatar.relight(frame.query), 1)]
    known = [1e3 * s for s in seconds(lambda: avatar.relight(frame.query), REPEATS)]
    return [
        summary(f"urhand relit frame, {kind}, first", "ms", new),
        summary(f"urhand relit frame, {kind}, known pose", "ms", known, goal=50),
    ]
