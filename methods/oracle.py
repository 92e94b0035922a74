"""The oracle: the recorded truth fed back. Its scores are perfect, or the run is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from handbench.errors import Unsupported
from handbench.method import Avatar, Method, MethodInfo, Prior, Progress, RecordedAvatar, Recording, silent
from handbench.scene import LIGHT_KINDS, Frame, Prediction, Query, needed


class OracleAvatar(RecordedAvatar):
    def __init__(self, truth: Recording) -> None:
        self._truth = truth
        self._frames: dict[str, Frame] = {frame.key: frame for frame in truth.frames}

    def relight(self, query: Query) -> Prediction:
        frame = self._frames.get(query.key)
        if frame is None:
            raise Unsupported(f"the oracle only knows recorded frames, and {query.key} is not one of them")
        seen = self._truth.observe(frame)
        alpha = needed(seen.alpha, "alpha")
        return Prediction(seen.image, alpha, depth=seen.depth, normal=seen.normal, mesh=frame.mesh)


class OraclePrior(Prior):
    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        return OracleAvatar(enrolment)

    def save(self, folder: Path) -> None:
        """Nothing is learned, so nothing is written."""


class Oracle(Method):
    info = MethodInfo(
        name="oracle",
        title="Oracle",
        summary="the path-traced truth fed back",
        universal=True,
        linear=True,
        role="calibration",
        truth=True,
        lights=LIGHT_KINDS,
        fidelity="calibration: must be perfect",
    )

    @property
    def config(self) -> dict[str, Any]:
        return {}

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        return OraclePrior()

    def load(self, folder: Path) -> Prior:
        return OraclePrior()


def create(preset: str = "quick") -> Method:
    """The oracle; every preset is the same."""
    return Oracle()
