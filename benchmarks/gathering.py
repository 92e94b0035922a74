"""What gathering light costs and errs on a hand: `python -m benchmarks.gathering`.

The open hand in a pose, of one material, under environments: error of the three ways to draw directions, and of distant
lights, against their number, beside all texels of a map; and what marched shadows miss beside rays against the mesh.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace

import numpy as np
import open3d
import torch
from open3d.t.geometry import RaycastingScene
from rich.console import Console
from rich.table import Table
from torch import Tensor

from handbench.data.openstage.stage import environment
from handbench.hand.openhand import OpenHand
from handbench.light.environment import resize, to_directional
from handbench.light.lightset import light_samples
from handbench.light.stage import stage_directions
from handbench.methods.palm.gathering import Gatherer, Gathering
from handbench.methods.palm.reflectance import Material
from handbench.methods.palm.scattering import LIFT, Scattering
from handbench.methods.palm.visibility import BODY_SCALE, HAND_SCALE, DensityOccluder, March, MeshOccluder
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import rasterise
from handbench.render.volume import laplace_density
from handbench.scene import Camera, Directional, Environment, Group

MAPS = ("brightday", "nightlights")
COUNTS = (32, 128, 512)
FINE = 48
"""Rows of the map that tells the truth."""

FOOT = 5e-4
"""Metres in which the marched density rises."""


def posed(pose: str) -> PosedMesh:
    hand = OpenHand.load()
    return PosedMesh(hand.mesh(hand.neutral(), hand.named_pose(pose), 1))


def places(mesh: PosedMesh, camera: Camera) -> Scattering:
    """One place for each pixel whose middle sees the mesh."""
    raster = rasterise(mesh, camera, 1)
    normal = torch.from_numpy(raster.normal).float()
    corners = mesh.vertices[mesh.topology.faces[raster.face]]
    point = torch.from_numpy((raster.barycentric[..., None] * corners).sum(axis=1)).float() + LIFT * normal
    view = torch.nn.functional.normalize(torch.from_numpy(camera.centre).float() - point, dim=1)
    count = len(point)
    skin = Material(torch.tensor([0.5, 0.35, 0.28]).repeat(count, 1), torch.full((count,), 0.4), torch.zeros(count))
    return Scattering(count, torch.arange(count), torch.ones(count), point, normal, view, skin)


@dataclass(frozen=True)
class Error:
    """Relative RMS error of pixels, and seconds of processor time."""

    way: str
    light: str
    count: int
    error: float
    seconds: float


def errors(where: Scattering, occluder: MeshOccluder, light: Environment, repeats: int) -> list[Error]:
    """Each way's error against a light in the middle of every 1/16 of a texel."""
    fine = Group(tuple(map(Directional, *to_directional(resize(light, FINE, 2 * FINE)))))
    truth = Gatherer(where, occluder, Gathering()).colours(fine)
    found = []
    for way in ("strata", "light", "combined"):
        for fresh in (False, True) if way != "combined" else (True,):
            for count in COUNTS:
                runs, start = [], time.process_time()
                for seed in range(repeats):
                    how = Gathering(maps=way, directions=count, fresh=fresh, seed=seed)  # type: ignore[arg-type]
                    runs.append(float((Gatherer(where, occluder, how).colours(light) - truth).norm() / truth.norm()))
                seconds = (time.process_time() - start) / repeats
                name = way if way == "combined" else f"{way}, {'each place' if fresh else 'one set'}"
                found.append(Error(name, light.name, count, float(np.mean(runs)), seconds))
    for error in (0.01, 0.0025):
        start = time.process_time()
        drawn = Gatherer(where, occluder, Gathering(error=error)).colours(light)
        seconds, count = time.process_time() - start, len(light_samples(light, environment_error=error))
        found.append(Error("distant lights", light.name, count, float((drawn - truth).norm() / truth.norm()), seconds))
    return found


def exponent(found: list[Error], way: str, light: str) -> float:
    """The power of the count by which the error of a way falls."""
    own = [e for e in found if e.way == way and e.light == light]
    return float(np.polyfit(np.log([e.count for e in own]), np.log([e.error for e in own]), 1)[0])


def missed(where: Scattering, mesh: PosedMesh, march: March) -> tuple[float, float]:
    """Of directions that the mesh hides the share that a march sees at more than a half; and the other way round."""
    scene, tensor = RaycastingScene(), open3d.core.Tensor
    faces = np.ascontiguousarray(mesh.topology.faces, dtype=np.uint32)
    scene.add_triangles(tensor.from_numpy(mesh.vertices.astype(np.float32)), tensor.from_numpy(faces))

    def density(points: Tensor) -> Tensor:
        sdf = torch.from_numpy(scene.compute_signed_distance(tensor.from_numpy(points.numpy())).numpy())
        return laplace_density(sdf, FOOT)

    towards = torch.from_numpy(stage_directions(64)).float()
    some = where.at(torch.arange(0, len(where.ray), max(1, len(where.ray) // 120)))
    above = some.normal @ towards.T > 0.05
    hard = MeshOccluder(mesh).of_all(some.point, some.normal, towards)[above]
    soft = DensityOccluder(density, march).of_all(some.point, some.normal, towards)[above]
    return float((soft[hard == 0] > 0.5).float().mean()), float((soft[hard == 1] <= 0.5).float().mean())


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gathering", description=__doc__)
    parser.add_argument("--repeats", type=int, default=3, help="estimates of each error (default: 3)")
    arguments = parser.parse_args()
    camera = Camera(
        "front",
        30,
        40,
        np.array([[88.0, 0, 15], [0, 88.0, 27], [0, 0, 1]]),
        np.c_[np.diag([1.0, -1, -1]), [0, 0, 0.45]],
    )
    mesh = posed("rest")
    where = places(mesh, camera)
    found = []
    for name in MAPS:
        light = resize(environment(name, 64), 16, 32)
        found += errors(where, MeshOccluder(mesh), light, arguments.repeats)
    table = Table(box=None, header_style="dim", title=f"Error of light gathered at {len(where.ray)} places")
    for title in ("way", "light", "directions", "error", "seconds"):
        table.add_column(title)
    for e in found:
        table.add_row(e.way, e.light, str(e.count), f"{100 * e.error:.2f} %", f"{e.seconds:.2f}")
    Console().print(table)
    for way in dict.fromkeys(e.way for e in found if e.way != "distant lights"):
        powers = ", ".join(f"{exponent(found, way, name):.2f} ({name})" for name in MAPS)
        print(f"{way}: error ~ directions^ {powers}")
    for pose in ("rest", "fist"):
        own = posed(pose)
        at = places(own, camera)
        for name, march in (
            ("released, 64 over 1.5 m", BODY_SCALE),
            ("hand scale, 64 over 0.3 m", HAND_SCALE),
            ("32 over 0.3 m", replace(HAND_SCALE, samples=32)),
        ):
            lost, false = missed(at, own, march)
            print(
                f"{pose}, {name}: misses {100 * lost:.1f} % of what is hidden, hides {100 * false:.1f} % of what is not"
            )


main()
