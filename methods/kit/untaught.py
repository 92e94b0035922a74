"""Methods that other people's frames teach nothing: all is learned of the enrolled person."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from handbench.method import Avatar, Method, MethodInfo, Prior, Progress, Recording, silent

from .weights import load_state, save_state

Personalise: TypeAlias = Callable[[Recording, int, Progress], Avatar]
"""What makes an avatar of an enrolment, with a seed."""

Restore: TypeAlias = Callable[[Path], Avatar]
"""What reads an avatar back that `Avatar.save` wrote."""


class Untaught(Method):
    """A method by what it says of itself, its configuration, and how it personalises; its training does nothing.

    `restore` is None for a method whose avatars cannot be kept.
    """

    def __init__(
        self, info: MethodInfo, config: Mapping[str, Any], personalise: Personalise, restore: Restore | None = None
    ) -> None:
        self.info, self._config, self._personalise, self._restore = info, dict(config), personalise, restore

    @property
    def config(self) -> dict[str, Any]:
        return dict(self._config)

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        return UntaughtPrior(self.info.name, self._config, self._personalise, self._restore)

    def load(self, folder: Path) -> Prior:
        load_state(folder, self.info.name, self._config)
        return UntaughtPrior(self.info.name, self._config, self._personalise, self._restore)


class UntaughtPrior(Prior):
    """Nothing but the configuration."""

    def __init__(
        self, method: str, config: Mapping[str, Any], personalise: Personalise, restore: Restore | None = None
    ) -> None:
        self._method, self._config, self._personalise, self._restore = method, config, personalise, restore

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        return self._personalise(enrolment, seed, progress)

    def save(self, folder: Path) -> None:
        save_state(folder, self._method, self._config, {})

    def restore(self, folder: Path) -> Avatar:
        return super().restore(folder) if self._restore is None else self._restore(folder)
