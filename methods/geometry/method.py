"""Another method on the autoencoder's meshes in place of the capture's (URHand supp. Sec. 4.1).

The autoencoder is trained on the fully lit training frames and frozen, then the method is trained on the same frames
with tracked geometry. A pose that training or enrolment shows fully lit is tracked with those pictures; any other
pose, such as that of a held-out query, is followed by its joints alone. No picture of a scored pose is looked at
unless the protocol's enrolment holds it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from handbench.errors import Unsupported
from handbench.hand import hand_of
from handbench.method import Avatar, Method, MethodInfo, PosedAvatar, Prior, Progress, Recording, silent
from handbench.scene import Camera, Light, Mesh, Prediction, Viewpoint, needed
from handbench.settings import UNCHANGED, Changes, parted

from .. import urhand
from ..reflectance import physical
from .model import GeometryModel
from .tracker import NAME, GeometryPrior, Tracker, Tracking
from .tracker import create as create_tracker

_APART = 0.2  # metres between the middle of a query's mesh and its wrist: a hand is smaller

METHODS: dict[str, Callable[[str, Changes], Method]] = {
    # the physical BRDF has no smaller preset than its quick one
    "physical": lambda preset, changes: physical.create("quick" if preset == "smoke" else preset, changes),
    "urhand": lambda preset, changes: urhand.create(preset, changes=changes),
}


class TrackedAvatar(Avatar):
    """An avatar that is asked for queries with tracked meshes; of the query's own mesh only the topology is used."""

    def __init__(self, inner: Avatar, tracking: Tracking, model: GeometryModel) -> None:
        self._inner, self._tracking, self._surface = inner, tracking, (model.hand, model.level)

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        mesh, wrist = needed(viewpoint.mesh, "mesh"), needed(viewpoint.pose, "pose").translation
        if hand_of(mesh.topology) != self._surface:
            raise Unsupported(f"{viewpoint.pose_key} has a mesh of another resolution than the training frames")
        # a pose that does not belong to the mesh would be drawn somewhere else without a word
        if np.linalg.norm(mesh.vertices.mean(axis=0) - wrist) > _APART:
            raise Unsupported(f"the mesh of {viewpoint.pose_key} does not lie where its pose says")
        found = self._tracking.of(viewpoint)
        return PosedTracked(self._inner.pose(replace(viewpoint, mesh=found.mesh, pose=found.pose)), found.mesh)


class PosedTracked(PosedAvatar):
    """A posed avatar whose pictures come with the tracked mesh."""

    def __init__(self, inner: PosedAvatar, mesh: Mesh) -> None:
        self._inner, self._mesh = inner, mesh

    def relight(self, light: Light) -> Prediction:
        return replace(self._inner.relight(light), mesh=self._mesh)

    def seen_by(self, camera: Camera) -> PosedAvatar:
        return PosedTracked(self._inner.seen_by(camera), self._mesh)


class TrackedPrior(Prior):
    """The frozen autoencoder, and what the method learned on its meshes."""

    def __init__(self, geometry: GeometryPrior, inner: Prior) -> None:
        self.geometry, self.inner = geometry, inner

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        tracking = Tracking(self.geometry, enrolment, blind=True)
        inner = self.inner.personalise(tracking.recording(enrolment), seed, progress)
        return TrackedAvatar(inner, tracking, self.geometry.model)

    def save(self, folder: Path) -> None:
        for name, prior in ((NAME, self.geometry), ("method", self.inner)):
            (folder / name).mkdir()
            prior.save(folder / name)


class TrackedMethod(Method):
    """A method on tracked meshes. Its configuration is the tracker's and its own."""

    def __init__(self, tracker: Tracker, inner: Method) -> None:
        self._tracker, self._inner = tracker, inner
        told = inner.info
        self.info: MethodInfo = replace(
            told,
            name=f"{told.name}-tracked",
            title=f"{told.title}, tracked",
            needs=told.needs | {"mesh", "pose", "depth", "full"},
            trains_on=told.trains_on | {"image", "alpha", "camera", "mesh", "pose", "depth", "full"},
            summary=f"{told.summary}; meshes of the hand geometry autoencoder",
        )

    @property
    def config(self) -> dict[str, Any]:
        return {NAME: self._tracker.config, "method": self._inner.config}

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        """Raises `Unsupported` as `Tracker.train` does."""

        def tell(step: int, total: int, **values: float) -> None:
            progress(step, total, **{f"{NAME} {name}": value for name, value in values.items()})

        geometry = self._tracker.train(recording, seed, tell)
        tracking = Tracking(geometry, recording, blind=True)
        return TrackedPrior(geometry, self._inner.train(tracking.recording(recording), seed, progress))

    def load(self, folder: Path) -> Prior:
        return TrackedPrior(self._tracker.load(folder / NAME), self._inner.load(folder / "method"))


def create(preset: str = "quick", method: str = "physical", changes: Changes = UNCHANGED) -> Method:
    """One of `METHODS` on tracked meshes, both at a preset with changed settings; `InputError` for unknown ones."""
    of_tracker, of_method = parted(changes, (NAME, "method"), f"{method}-tracked")
    return TrackedMethod(create_tracker(preset, of_tracker), METHODS[method](preset, of_method))
