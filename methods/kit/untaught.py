"""Methods that other people's frames teach nothing: all is learned of the enrolled person."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from handbench.method import Avatar, Method, MethodInfo, Prior, Progress, Recording, silent

from .weights import load_state, save_state

Personalise: TypeAlias = Callable[[Recording, int, Progress], Avatar]
"""What makes an avatar of an enrolment, with a seed."""


class Untaught(Method):
    """A method by what it says of itself, its configuration, and how it personalises; its training does nothing."""

    def __init__(self, info: MethodInfo, config: Mapping[str, Any], personalise: Personalise) -> None:
        self.info, self._config, self._personalise = info, dict(config), personalise

    @property
    def config(self) -> dict[str, Any]:
        return dict(self._config)

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        return UntaughtPrior(self.info.name, self._config, self._personalise)

    def load(self, folder: Path) -> Prior:
        load_state(folder, self.info.name, self._config)
        return UntaughtPrior(self.info.name, self._config, self._personalise)


class UntaughtPrior(Prior):
    """Nothing but the configuration."""

    def __init__(self, method: str, config: Mapping[str, Any], personalise: Personalise) -> None:
        self._method, self._config, self._personalise = method, config, personalise

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        return self._personalise(enrolment, seed, progress)

    def save(self, folder: Path) -> None:
        save_state(folder, self._method, self._config, {})
