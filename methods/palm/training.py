"""Training of PALM-Net's prior: geometry on scans first, then everything on pictures, physical colours last.

What a run of minutes on a CPU needs and the seed does not do, each named in `PalmConfig`: poses and shapes are
registered to scans; geometry is begun on points around scans (`geometry_steps`, `scan_points`), as the released code
begins it on points around MANO's meshes, where the seed has images, normals and masks only; all people share one
canonical space. Random gamma and colour jitter, which the seed lists and the code does not have, are left out.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from handbench.hand import HandModel
from handbench.hand.canonical import NearestBones, canonicalise
from handbench.method import Progress, Recording
from handbench.render.see.posedmesh import PosedMesh

from ..kit.engine import Player, fit
from . import losses
from .config import PalmConfig
from .frames import Taken, drawn, taken
from .model import PalmModel
from .posed import PosedHand, Rendering, render
from .shading import physical
from .visibility import MeshOccluder

_SCALE = 5e-3  # metres of a scan's distance that cost one


def trained(config: PalmConfig, hand: HandModel, recording: Recording, seed: int, progress: Progress) -> PalmModel:
    """The model that learned from a recording.

    Raises `NonFinite`, which names the step and each term's value, as soon as one is not finite; `Unsupported` for a
    recording that it cannot be trained on.
    """
    poses = taken(recording, hand, config.register, seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        model = PalmModel(config, hand, 1 + poses[-1].person)
    lesson = Lesson(model, poses)
    stages = [("palm-geometry", lesson.geometry, config.geometry_steps), ("palm", lesson.pictures, config.steps)]
    total = sum(steps for _, _, steps in stages)
    done = 0
    for name, terms, steps in stages:
        if steps:
            player = Player("prior", model, terms)
            fit(name, [player], len(poses), config.budget(steps), seed, _counted(progress, done, total))
            done += steps
    return model


def _counted(progress: Progress, done: int, every: int) -> Progress:
    """`progress` of a stage as that of the whole, of `every` steps."""

    def tell(step: int, total: int, **values: float) -> None:
        progress(done + step, every, **values)

    return tell


class Lesson:
    """The losses of the model on poses of people.

    Hands are posed once and kept, and what they hide: their codes change, their poses do not.
    """

    def __init__(self, model: PalmModel, poses: list[Taken]) -> None:
        self.model, self.config, self.poses = model, model.config, poses
        self._posed: dict[int, PosedHand] = {}
        self._shadows: dict[int, MeshOccluder] = {}

    def posed(self, sample: int) -> PosedHand:
        """The hand of a pose with its codes as they are now."""
        pose = self.poses[sample]
        if sample not in self._posed:
            told = (pose.pose.joints, pose.pose.rotation, pose.pose.translation)
            placed = (torch.from_numpy(values.copy()).float() for values in told)
            with torch.no_grad():
                self._posed[sample] = PosedHand(self.model, self.model.codes(pose.person), pose.shape, *placed)
        return self._posed[sample].moved(codes=self.model.codes(pose.person))

    def geometry(self, sample: int, rng: np.random.Generator) -> Mapping[str, Tensor]:
        """The terms of the first stage: the scan's distances and normals, eikonal, codes."""
        posed = self.posed(sample)
        return {**self._scan(posed, sample, 4 * max(self.config.scan_points, 256), rng), **self._latent(sample)}

    def pictures(self, sample: int, rng: np.random.Generator) -> Mapping[str, Tensor]:
        """All terms of the seed's Sec. 5 as far as this step's schedule has them, and the scan's where there are."""
        config, pose, posed = self.config, self.poses[sample], self.posed(sample)
        share = float(self.model.drawn) / config.steps
        self.model.drawn += 1
        rays = drawn(pose, config.rays, config.patch, rng)
        found = render(posed, rays.origins, rays.directions, rng=rng)
        background = torch.from_numpy(rng.random(3)).float()
        radiance = losses.colours(found.radiance(posed), found.alpha, rays, background)
        terms = {"l1": (radiance[0] - radiance[1]).abs().mean()}
        terms["mask"] = config.mask * losses.mask(found.alpha, rays)
        if config.perceptual and config.patch:
            terms["perceptual"] = config.perceptual * losses.patches(radiance, config.patch)
        terms |= self._surface(posed, found, sample, share, rng)
        if rays.normal is not None and config.normal and share >= config.normals_from:
            terms["normal"] = config.normal * (1.0 - 0.8 * share) * losses.normals(found, rays)
        if config.physical and share >= config.light_from:
            if sample not in self._shadows:
                self._shadows[sample] = MeshOccluder(PosedMesh(pose.mesh))
            shadows, gaussians = self._shadows[sample], self.model.light.gaussians()
            made = physical(posed, found, gaussians, shadows, config.scattered, rng, places=config.places)
            shown = losses.colours(made, found.alpha.detach(), rays, background)
            terms["physical"] = config.physical * (shown[0] - shown[1]).abs().mean()
        return {**terms, **self._latent(sample)}

    def _surface(
        self, posed: PosedHand, found: Rendering, sample: int, share: float, rng: np.random.Generator
    ) -> dict[str, Tensor]:
        """What keeps the surface a surface: scans, eikonal, curvature."""
        config, terms = self.config, dict[str, Tensor]()
        if config.scan_points:
            terms |= self._scan(posed, sample, config.scan_points, rng)
        if len(found.ray):
            seen = config.eikonal * losses.eikonal(found.gradient)
            terms["eikonal"] = terms["eikonal"] + seen if "eikonal" in terms else seen
            if config.curvature and share >= config.normals_from:
                tangent = torch.from_numpy(rng.standard_normal((len(found.ray), 3))).float()
                terms["curvature"] = config.curvature * losses.curvature(posed, found, tangent)
        return terms

    def _scan(self, posed: PosedHand, sample: int, count: int, rng: np.random.Generator) -> dict[str, Tensor]:
        """How far the field is from a scan, on its surface and beside it.

        A point belongs to the sheet of the nearest bone: which one that is must not depend on an unfinished field.
        """
        config, bank = self.config, self.poses[sample].bank
        half = len(bank.points) // 2
        halves = [rng.integers(half, size=count // 2), half + rng.integers(half, size=count - count // 2)]
        chosen = torch.from_numpy(np.concatenate(halves))
        roots = canonicalise(posed.deformation, posed.local(bank.points[chosen]), NearestBones(1))
        there = roots.valid[:, 0]
        x, chosen = roots.x[there, 0], chosen[there]
        found = self.model.geometry(x, posed.conditions, gradient=True)
        assert found.gradient is not None
        on = chosen < half
        facing = (posed.normals(x[on], found.gradient[on]) * bank.normal[chosen[on]]).sum(dim=1)
        return {
            "scan": config.scan * ((found.sdf - bank.distance[chosen]) / _SCALE).abs().mean(),
            "scan_normal": config.scan_normal * (1.0 - facing).mean(),
            "eikonal": config.eikonal * losses.eikonal(found.gradient),
        }

    def _latent(self, sample: int) -> dict[str, Tensor]:
        codes = self.model.codes(self.poses[sample].person)
        size = codes.geometry.square().sum() + codes.appearance.square().sum()
        return {"latent": self.config.latent * size}
