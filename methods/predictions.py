"""A prediction folder as a method of the bench: what it is asked, it looks up."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from handbench.data.predictionfiles import nested_path
from handbench.data.predictions.folder import PredictionFolder
from handbench.data.predictions.picture import UnfitPicture, read_picture
from handbench.errors import InputError, Unsupported
from handbench.method import Avatar, Method, MethodInfo, Prior, Progress, RecordedAvatar, Recording, silent
from handbench.registry import Entry
from handbench.scene import LIGHT_KINDS, Prediction, Query

FIDELITY = "predictions from a folder, not run here"


class FolderAvatar(RecordedAvatar):
    def __init__(self, folder: Path, suffix: str) -> None:
        self._folder, self._suffix = folder, suffix

    def relight(self, query: Query) -> Prediction:
        path = nested_path(self._folder, query.key, self._suffix)
        if not path.exists():
            raise Unsupported("the prediction folder has no picture of this query")
        try:
            return read_picture(path, query.camera)
        except UnfitPicture as error:  # it was whole when the folder was checked
            raise InputError(f"picture {path} {error}; it has changed, score again") from error


class FolderPrior(Prior):
    def __init__(self, folder: Path, suffix: str) -> None:
        self._folder, self._suffix = folder, suffix

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        return FolderAvatar(self._folder, self._suffix)

    def save(self, folder: Path) -> None:
        """Nothing is learned, so nothing is written."""


class FolderMethod(Method):
    def __init__(self, folder: Path, suffix: str, info: MethodInfo, config: dict[str, Any]) -> None:
        self._folder, self._suffix, self.info, self._config = folder, suffix, info, config

    @property
    def config(self) -> dict[str, Any]:
        return self._config

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        return FolderPrior(self._folder, self._suffix)

    def load(self, folder: Path) -> Prior:
        return FolderPrior(self._folder, self._suffix)


def entry_of(found: PredictionFolder, name: str) -> Entry:
    """The plug-in that is a folder; its settings tell the content, so other content is computed anew."""
    told = json.dumps(asdict(found.times)) if found.times else ""
    manifest = found.manifest
    settings = {"folder": str(found.path.absolute()), "name": name, "title": manifest.title, "note": manifest.note}
    settings |= {"times": told, "content": found.digest, "suffix": manifest.suffix}
    return Entry(name, f"{__name__}:create", FIDELITY, tuple(settings.items()), presets=False)


def create(
    preset: str = "quick", *, folder: str, name: str, title: str, note: str, times: str, content: str, suffix: str
) -> Method:
    """The method that looks pictures up in a folder; every preset is the same."""
    told = json.loads(times) if times else None
    claim = f"; its authors tell {told['median_ms']:.3g} ms a frame on {told['device']}" if told else ""
    info = MethodInfo(
        name=name,
        title=title,
        summary=note or "pictures that were drawn elsewhere",
        universal=True,
        lights=LIGHT_KINDS,
        fidelity=FIDELITY + claim,
        timed=False,
    )
    return FolderMethod(
        Path(folder), suffix, info, {"content": content, "note": note, "times told by its authors": told}
    )
