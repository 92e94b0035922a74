"""Training of the autoencoder on the fully lit frames of all subjects (URHand supp. Sec. 4.1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from handbench.hand import HandModel
from handbench.method import Progress, Recording
from handbench.scene import Array, Camera, needed

from ..kit.engine import Player, fit
from .model import GeometryModel
from .nearest import closest
from .networks import divergence
from .neutral import Neutral, full_frames, neutral, warped
from .scan import PointCloud, point_cloud, square_picture

_MM = 1000.0
_HANDS = 256  # that the identity networks start from


@dataclass(frozen=True, eq=False)
class _Sample:
    """A fully lit frame: picture (3, S, S), key points (P, 3) in the world, and its pose's scan (N, 3)."""

    subject: str
    camera: Camera
    picture: Tensor
    observed: Array
    scan: Array


def train(model: GeometryModel, recording: Recording, seed: int, progress: Progress) -> None:
    """Train in place. Raises `Unsupported` for a recording that `neutral` or `point_cloud` refuses, `NonFinite`."""
    lesson = Lesson(model, recording)
    model.start(lesson.hands(np.random.default_rng([23, seed])))
    fit(
        "geometry",
        [Player("autoencoder", model, lesson.losses)],
        len(lesson.samples),
        model.config.budget,
        seed,
        progress,
    )


class Lesson:
    """The losses on the fully lit frames of a recording."""

    def __init__(self, model: GeometryModel, recording: Recording) -> None:
        self.model = model
        lit = full_frames(recording)
        self.neutrals: dict[str, Neutral] = {s: neutral(lit.of_subject(s)) for s in lit.subjects}
        self.samples: list[_Sample] = []
        poses = dict.fromkeys(frame.pose_key for frame in lit.frames)
        for pose in poses:  # the scan of a pose is what all its cameras see together
            views = [(frame, lit.observe(frame)) for frame in lit.frames if frame.pose_key == pose]
            points = point_cloud(views).points
            for frame, seen in views:
                observed = self.neutrals[frame.subject].observed(needed(frame.pose, "pose"))
                drawn = square_picture(seen.image, frame.camera, observed, model.config.image)
                self.samples.append(_Sample(frame.subject, frame.camera, drawn, observed, points))

    def hands(self, rng: np.random.Generator) -> list[Array]:
        """Key points (P, 3) of neutral hands as a training shows them: of random size, half of them deformed."""
        people = list(self.neutrals.values())
        return [self._identity(people[i % len(people)], rng)[1] for i in range(_HANDS)]

    def _identity(self, person: Neutral, rng: np.random.Generator) -> tuple[PointCloud, Array, float, bool]:
        """Scan and key points (P, 3) of a person or of a deformed one, enlarged; the factor, and whether deformed."""
        config = self.model.config
        size = float(np.exp(rng.uniform(*np.log(config.scale))))
        other = config.warp > 0.0 and rng.integers(2) == 1
        seen, points = warped(person, config.warp, rng) if other else (person.scan, person.points)
        return seen.moved(np.eye(3), np.zeros(3), size), size * points, size, other

    def losses(self, number: int, rng: np.random.Generator) -> Mapping[str, Tensor]:
        """The four losses of supp. Sec. 4.1, the last as three regularisers, on one frame of a world of random size."""
        model, config, sample = self.model, self.model.config, self.samples[number]
        seen, points, size, other = self._identity(self.neutrals[sample.subject], rng)
        mean, log_variance = model.encode(seen, points)
        noise = model.here(rng.standard_normal(config.code))
        shape = model.shape(mean + noise * (0.5 * log_variance).exp())
        # a deformed hand exists in the neutral pose alone, and no picture shows it
        observed, surface = (points, seen.points) if other else (size * sample.observed, size * sample.scan)
        told = model.told(shape, observed)
        beyond = model.still if other else model.beyond(sample.picture, sample.camera, observed, told)
        posed = model.posed(shape, told, beyond)
        chosen = rng.choice(len(surface), min(config.points, len(surface)), replace=False)
        target = model.here(surface[chosen])
        apart = target - closest(posed.vertices, model.hand.topology(model.level).faces, target)
        rough = torch.stack(
            [
                torch.sparse.mm(laplacian(model.hand, x.device), _MM * x).square().mean()
                for x in (shape.offsets, posed.correctives)
            ]
        )
        return {
            "joint": config.joint * (_MM * (posed.points - model.here(observed))).abs().mean(),
            "scan": config.scan * (_MM * apart).abs().mean(),
            "code": config.divergence * divergence(mean, log_variance),
            "smooth": config.smooth * rough.sum(),
            "small": config.small * (_MM * posed.correctives).square().mean(),
            "steady": config.steady * beyond[:-1].square().mean(),
        }


def laplacian(hand: HandModel, device: torch.device) -> Tensor:
    """Each coarse vertex minus the mean of its neighbours, (V, V) sparse."""
    return hand.kept(("laplacian", device), lambda: _laplacian(hand).to(device))


def _laplacian(hand: HandModel) -> Tensor:
    pairs = hand.edges()
    pairs = np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0)
    count = len(hand.rest_position(0))
    share = 1.0 / np.bincount(pairs[:, 0], minlength=count)
    index = np.concatenate([np.tile(np.arange(count), (2, 1)), pairs.T], axis=1)
    values = np.concatenate([np.ones(count), -share[pairs[:, 0]]])
    matrix = torch.sparse_coo_tensor(
        torch.from_numpy(index), torch.from_numpy(values).float(), (count, count), check_invariants=False
    )
    return matrix.coalesce()
