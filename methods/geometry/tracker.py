"""Tracking with the autoencoder: train once, identify a subject from its neutral frames, then track its poses."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from handbench.device import device
from handbench.errors import InputError, NonFinite, Unsupported
from handbench.hand import hand_model, hand_of
from handbench.method import Progress, Recording, silent
from handbench.scene import Array, Frame, Mesh, Pose, Topology, Viewpoint, needed
from handbench.settings import UNCHANGED, Changes, changed

from ..kit.host import on_host
from ..kit.weights import load_state, save_state
from .config import GeometryConfig, configuration
from .model import GeometryModel, Shape, combined
from .neutral import Neutral, full_frames, neutral
from .scan import square_picture
from .skeleton import ToldPose
from .training import train

NAME = "geometry"


@dataclass(frozen=True, eq=False)
class TrackedSubject:
    """A subject whose identity code is known."""

    neutral: Neutral
    shape: Shape


@dataclass(frozen=True, eq=False)
class Tracked:
    """A pose as tracked: mesh over the capture's topology, pose, and key points (P, 3) in the world."""

    mesh: Mesh
    pose: Pose
    points: Array


class GeometryPrior:
    """What all training subjects taught: a general hand tracker."""

    def __init__(self, model: GeometryModel) -> None:
        self.model = model.eval()

    @torch.no_grad()
    def identify(self, enrolment: Recording) -> TrackedSubject:
        """The mean identity of a recording's one subject.

        Raises `Unsupported` without fully lit frames with depth in a neutral pose, `NonFinite` for a hand that is not.
        """
        found = neutral(enrolment)
        mean, _ = self.model.encode(found.scan, found.points)
        shape = self.model.shape(mean)
        if not (shape.points.isfinite().all() and shape.vertices.isfinite().all()):
            raise NonFinite("geometry: the hand at rest is not finite; train again")
        return TrackedSubject(found, shape)

    @torch.no_grad()
    def track(self, person: TrackedSubject, views: Recording) -> Tracked:
        """The geometry of one pose of a person from its fully lit frames: what cameras add to the pose is averaged.

        Raises `Unsupported` if there are none, `NonFinite` if the surface is not finite.
        """
        lit, model = full_frames(views), self.model
        observed = person.neutral.observed(needed(lit.frames[0].pose, "pose"))
        told = model.told(person.shape, observed)
        added = [
            model.beyond(
                square_picture(lit.observe(f).image, f.camera, observed, model.config.image), f.camera, observed, told
            )
            for f in lit.frames
        ]
        return self._tracked(person, told, torch.stack(added).mean(dim=0), needed(lit.frames[0].mesh, "mesh").topology)

    @torch.no_grad()
    def follow(self, person: TrackedSubject, pose: Pose, topology: Topology) -> Tracked:
        """The geometry of a pose that no picture shows, from its joints alone: E_theta is not asked.

        Raises `NonFinite` as `track` does.
        """
        told = self.model.told(person.shape, person.neutral.observed(pose))
        return self._tracked(person, told, self.model.still, topology)

    def _tracked(self, person: TrackedSubject, told: ToldPose, beyond: Tensor, topology: Topology) -> Tracked:
        posed = self.model.posed(person.shape, told, beyond)
        if not posed.vertices.isfinite().all():
            raise NonFinite("geometry: the tracked surface is not finite; train again")
        vertices, points = on_host(posed.vertices), on_host(posed.points)
        return Tracked(Mesh(vertices, topology), combined(told, beyond), points)

    def save(self, folder: Path) -> None:
        """Write everything `Tracker.load` needs into an existing folder."""
        name = torch.tensor([*self.model.hand.name.encode()], dtype=torch.uint8)
        state = {**self.model.state_dict(), "level": torch.tensor(self.model.level), "hand": name}
        save_state(folder, NAME, asdict(self.model.config), state)


class Tracker:
    """The autoencoder with its configuration."""

    def __init__(self, config: GeometryConfig) -> None:
        self._config = config

    @property
    def config(self) -> dict[str, Any]:
        """Every setting that can change a result, as JSON values."""
        return asdict(self._config)

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> GeometryPrior:
        """Learn from the fully lit frames of all subjects.

        Raises `Unsupported` if there are none, if they have no depth, or if a subject lacks a neutral pose.
        """
        hand, level = hand_of(needed(full_frames(recording).frames[0].mesh, "mesh").topology)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            model = GeometryModel(self._config, hand, level).to(device())
        train(model, recording, seed, progress)
        return GeometryPrior(model)

    def load(self, folder: Path) -> GeometryPrior:
        """The prior that `GeometryPrior.save` wrote. Raises `InputError` for another version or configuration."""
        state = load_state(folder, NAME, asdict(self._config))
        try:
            hand = hand_model(bytes(state.pop("hand").tolist()).decode())
            model = GeometryModel(self._config, hand, int(state.pop("level")))
            model.load_state_dict(state)
        except (KeyError, ValueError, TypeError, RuntimeError) as error:
            raise InputError(f"weights in {folder} are of another version of {NAME}; train again") from error
        return GeometryPrior(model.to(device()))


def create(preset: str = "quick", changes: Changes = UNCHANGED) -> Tracker:
    """The tracker at a preset with changed settings; `InputError` for unknown ones."""
    return Tracker(changed(configuration(preset), changes, NAME))


class Tracking:
    """Frames and queries with the autoencoder's mesh and pose in place of the capture's.

    `lit` holds the fully lit frames that are looked at: those of every pose asked for, and of every subject one in the
    neutral pose. In a recording a pose is tracked once, and all of its frames share the tracked mesh. The prior is
    frozen (supp. Sec. 4.1). With `blind`, poses that no fully lit frame shows are followed by their joints alone.
    """

    def __init__(self, prior: GeometryPrior, lit: Recording, blind: bool = False) -> None:
        self._prior, self._lit, self._blind = prior, full_frames(lit), blind
        self._persons: dict[str, TrackedSubject] = {}

    def of(self, asked: Viewpoint | Frame) -> Tracked:
        """The geometry of the pose of a viewpoint or frame.

        Raises `Unsupported` if no fully lit frame shows it and without `blind`.
        """
        views = self._lit.where(lambda frame: frame.pose_key == asked.pose_key)
        if not views.frames and not self._blind:
            raise Unsupported(
                f"{asked.pose_key} cannot be tracked: no fully lit frame of it was given; "
                "record one, or use the capture's own meshes"
            )
        person = self._person(asked.subject)
        if views.frames:
            return self._prior.track(person, views)
        return self._prior.follow(person, needed(asked.pose, "pose"), needed(asked.mesh, "mesh").topology)

    def _person(self, subject: str) -> TrackedSubject:
        if subject not in self._persons:
            self._persons[subject] = self._prior.identify(self._lit.of_subject(subject))
        return self._persons[subject]

    def recording(self, recording: Recording) -> Recording:
        """The same frames with tracked geometry, and the same images."""
        originals: dict[str, Frame] = {frame.key: frame for frame in recording.frames}
        poses: dict[str, Tracked] = {}
        frames = []
        for frame in recording.frames:
            found = poses.get(frame.pose_key) or poses.setdefault(frame.pose_key, self.of(frame))
            frames.append(replace(frame, mesh=found.mesh, pose=found.pose))
        return Recording(frames, lambda frame: recording.observe(originals[frame.key]))
