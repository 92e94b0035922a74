"""The mini capture's frames as a method sees them in training and enrolment."""

from __future__ import annotations

import pytest

from handbench.data.capture import Capture
from handbench.data.openstage import open_capture
from handbench.method import Recording


@pytest.fixture(scope="session")
def mini() -> Capture:
    return open_capture("mini")


@pytest.fixture(scope="session")
def training(mini: Capture) -> Recording:
    frames = [f for f in mini.frames() if f.subject == "s01" and f.segment == "train" and f.kind in ("olat", "full")]
    return mini.recording(f for f in frames if f.lighting not in ("olat-06", "olat-07"))


@pytest.fixture(scope="session")
def enrolment(mini: Capture) -> Recording:
    return mini.recording(f for f in mini.frames() if f.subject == "s02" and f.segment == "train" and f.kind == "full")
