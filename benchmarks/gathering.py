"""What marched shadows miss on a hand: `python -m benchmarks.gathering`.

The open hand in two poses, beside rays against its mesh. The errors of directions are measured by `handbench speed`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from handbench.lean import open3d
from handbench.light.stage import stage_directions
from handbench.methods.palm.scattering import Scattering
from handbench.methods.palm.visibility import BODY_SCALE, HAND_SCALE, DensityOccluder, March, MeshOccluder
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.volume import laplace_density
from handbench.studies.speed.gathering import camera, places, posed

FOOT = 5e-4
"""Metres in which the marched density rises."""


def missed(where: Scattering, mesh: PosedMesh, march: March) -> tuple[float, float]:
    """Of directions that the mesh hides the share that a march sees at more than a half; and the other way round."""
    scene, tensor = open3d().t.geometry.RaycastingScene(), open3d().core.Tensor
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
    for pose in ("rest", "fist"):
        own = posed(pose)
        at = places(own, camera())
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
