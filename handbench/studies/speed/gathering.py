"""Light on an implicit hand: error of the ways to draw directions, and of distant lights, against their number."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ...data.openstage.stage import environment
from ...hand import hand_model
from ...light.environment import resize, to_directional
from ...light.lightset import light_samples
from ...method import Progress, silent
from ...methods.palm.gathering import Gatherer, Gathering
from ...methods.palm.reflectance import Material
from ...methods.palm.scattering import LIFT, Scattering
from ...methods.palm.visibility import MeshOccluder
from ...render.see.posedmesh import PosedMesh
from ...render.see.raster import rasterise
from ...scene import Camera, Directional, Environment, Group
from .record import ImplicitPart, PartTrial

MAPS = {"brightday": "sun in a bright sky", "nightlights": "night with lamps"}
COUNTS = (32, 128, 512)
_FINE = 48  # rows of the map that tells the truth


@dataclass(frozen=True)
class Way:
    """How directions are chosen."""

    title: str
    gathering: Gathering


def _ways(count: int, seed: int) -> tuple[Way, ...]:
    def way(title: str, maps: str, fresh: bool) -> Way:
        return Way(title, Gathering(maps=maps, directions=count, fresh=fresh, seed=seed))  # type: ignore[arg-type]

    return (
        way("strata, one set", "strata", False),
        way("strata, a set for each place", "strata", True),
        way("light importance, one set", "light", False),
        way("light importance, a set for each place", "light", True),
        way("light and reflectance", "combined", True),
    )


def posed(pose: str) -> PosedMesh:
    """The neutral hand in a named pose."""
    hand = hand_model()
    return PosedMesh(hand.mesh(hand.neutral(), hand.named_pose(pose), min(1, hand.levels)))


def camera(height: int = 40) -> Camera:
    """Looks at the palm, a picture three quarters as wide as `height`."""
    focal, width = 2.2 * height, 3 * height // 4
    K = np.array([[focal, 0.0, width / 2], [0.0, focal, 0.675 * height], [0.0, 0.0, 1.0]])
    return Camera("front", width, height, K, np.c_[np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 0.45]])


def places(mesh: PosedMesh, view: Camera) -> Scattering:
    """One place for each pixel whose middle sees the mesh."""
    raster = rasterise(mesh, view, 1)
    normal = torch.from_numpy(raster.normal).float()
    corners = mesh.vertices[mesh.topology.faces[raster.face]]
    point = torch.from_numpy((raster.barycentric[..., None] * corners).sum(axis=1)).float() + LIFT * normal
    towards = torch.nn.functional.normalize(torch.from_numpy(view.centre).float() - point, dim=1)
    count = len(point)
    skin = Material(torch.tensor([0.5, 0.35, 0.28]).repeat(count, 1), torch.full((count,), 0.4), torch.zeros(count))
    return Scattering(count, torch.arange(count), torch.ones(count), point, normal, towards, skin)


def gathered(height: int, repeats: int, progress: Progress = silent) -> tuple[ImplicitPart, ...]:
    """Each way's error under each map: relative RMSE against a light in the middle of every ninth of a texel.

    Errors and seconds of CPU are means of `repeats` draws.
    """
    mesh = posed("rest")
    where, occluder = places(mesh, camera(height)), MeshOccluder(mesh)
    found: list[ImplicitPart] = []
    for done, (name, title) in enumerate(MAPS.items(), start=1):
        found += _under(resize(environment(name, 64), 16, 32), title, where, occluder, repeats)
        progress(done, len(MAPS))
    return tuple(found)


def _under(
    light: Environment, title: str, where: Scattering, occluder: MeshOccluder, repeats: int
) -> Sequence[ImplicitPart]:
    fine = Group(tuple(map(Directional, *to_directional(resize(light, _FINE, 2 * _FINE)))))
    truth = Gatherer(where, occluder, Gathering()).colours(fine)

    def measured(label: str, size: float, how: Sequence[Gathering]) -> PartTrial:
        errors, start = [], time.process_time()
        for one in how:
            errors.append(float((Gatherer(where, occluder, one).colours(light) - truth).norm() / truth.norm()))
        return PartTrial(label, size, float(np.mean(errors)), (time.process_time() - start) / len(how))

    parts = []
    for number, first in enumerate(_ways(1, 0)):
        points = []
        for count in COUNTS:
            how = [_ways(count, seed)[number].gathering for seed in range(repeats)]
            points.append(measured(f"{count} directions", count, how))
        parts.append(ImplicitPart(f"{title}: {first.title}", tuple(points)))
    few = Gathering()
    lights = len(light_samples(light, environment_error=few.error))
    return [*parts, ImplicitPart(f"{title}: distant lights", (measured(f"{lights} lights", lights, [few]),))]
