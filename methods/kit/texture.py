"""The mean texture: what a subject's skin looks like when lit from everywhere (URHand supp. Sec. 4.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt, map_coordinates
from torch import Tensor

from handbench.errors import Unsupported
from handbench.method import Recording
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.rays import RayScene
from handbench.render.uv.atlas import Atlas
from handbench.scene import Array, Camera, Frame, Observation, needed

_EDGE = 0.99  # a texel whose pixel is covered less is at the silhouette: background would bleed in


@dataclass(frozen=True)
class MeanTexture:
    """texture (3, R, R): mean radiance under the full stage, filled in where no camera saw; seen (R, R) bool."""

    texture: Tensor
    seen: Tensor


def mean_texture(enrolment: Recording, size: int) -> MeanTexture:
    """Visible pixels of one subject's fully lit frames, projected onto the texture and averaged.

    Each frame's pixels are weighted by the cosine between surface normal and view direction, so that
    grazing views count little. Unseen texels take the value of the nearest seen one.
    Raises `Unsupported` if there is no fully lit frame.
    """
    frames = enrolment.of_kind("full").frames
    if not frames:
        names = ", ".join(enrolment.subjects) or "the subject"
        raise Unsupported(f"the enrolment of {names} has no fully lit frame, and the mean texture is made from those")
    atlas = Atlas.of(needed(frames[0].mesh, "mesh").topology, size)
    total, weight = np.zeros((3, atlas.count)), np.zeros(atlas.count)
    for group in _by_pose(frames):
        surface = _TexelSurface.of(PosedMesh(needed(group[0].mesh, "mesh")), atlas)
        for frame in group:
            colour, cosine = surface.project(frame.camera, enrolment.observe(frame))
            total += colour * cosine
            weight += cosine
    seen = weight > 0
    if not seen.any():
        raise Unsupported(
            f"no camera of the enrolment of {enrolment.subjects[0]} sees the tracked mesh; check its units"
        )
    mean = torch.from_numpy(np.divide(total, weight, out=np.zeros_like(total), where=seen)).float()
    return MeanTexture(_fill(mean, seen, atlas), atlas.scatter(torch.from_numpy(seen)))


def _by_pose(frames: tuple[Frame, ...]) -> list[list[Frame]]:
    groups: dict[str, list[Frame]] = {}
    for frame in frames:
        groups.setdefault(frame.pose_key, []).append(frame)
    return list(groups.values())


@dataclass(frozen=True)
class _TexelSurface:
    """Positions and normals (N, 3) of the covered texels of one posed mesh, and its rays."""

    position: Array
    normal: Array
    scene: RayScene

    @staticmethod
    def of(mesh: PosedMesh, atlas: Atlas) -> _TexelSurface:
        normal = atlas.interpolate(mesh.normals)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        return _TexelSurface(atlas.interpolate(mesh.vertices), normal, mesh.rays)

    def project(self, camera: Camera, observation: Observation) -> tuple[Array, Array]:
        """Colours (3, N) that the camera saw at the texels, and their weights (N,), zero where it did not."""
        to_camera = camera.centre - self.position
        to_camera /= np.linalg.norm(to_camera, axis=1, keepdims=True)
        cosine = (self.normal * to_camera).sum(axis=1)
        places, _ = camera.project(self.position)
        behind = np.isnan(places)  # the camera: counts as outside the picture
        pixel = np.where(behind, -1.0, places)[:, ::-1].T - 0.5  # row, column of pixel centres
        alpha = map_coordinates(needed(observation.alpha, "alpha"), pixel, order=1, cval=0.0)
        facing = np.flatnonzero((cosine > 0) & (alpha > _EDGE))
        origin = self.position[facing] + self.scene.epsilon * self.normal[facing]
        hidden = self.scene.occluded(origin, camera.centre - origin, far=1.0)
        weight = np.zeros(len(cosine))
        weight[facing[~hidden]] = cosine[facing[~hidden]]
        colour = np.stack([map_coordinates(observation.image[..., c], pixel, order=1, cval=0.0) for c in range(3)])
        return colour, weight


def _fill(mean: Tensor, seen: Array, atlas: Atlas) -> Tensor:
    """The texture (3, R, R) of values (3, N), unseen and uncovered texels set to the nearest seen one."""
    known = atlas.scatter(torch.from_numpy(seen)).numpy()
    row, column = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return atlas.scatter(mean)[:, torch.from_numpy(row.copy()), torch.from_numpy(column.copy())]
