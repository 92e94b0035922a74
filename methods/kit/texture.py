"""The mean texture: what a subject's skin looks like when lit from everywhere (URHand supp. Sec. 4.2)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from handbench.errors import Unsupported
from handbench.method import Recording
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.unwrap import Projected, TexelSurface, averaged
from handbench.scene import Array, Frame, needed


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
    found = averaged(_projected(enrolment, frames, atlas))
    if not found.seen.any():
        raise Unsupported(
            f"no camera of the enrolment of {enrolment.subjects[0]} sees the tracked mesh; check its units "
            "and the winding of its faces (handbench data check)"
        )
    mean = torch.from_numpy(found.colour).float()
    return MeanTexture(_fill(mean, found.seen, atlas), atlas.scatter(torch.from_numpy(found.seen)))


def _projected(enrolment: Recording, frames: tuple[Frame, ...], atlas: Atlas) -> Iterator[Projected]:
    for group in _by_pose(frames):
        surface = TexelSurface.of(PosedMesh(needed(group[0].mesh, "mesh")), atlas)
        for frame in group:
            observation = enrolment.observe(frame)
            yield surface.project(frame.camera, observation.image, needed(observation.alpha, "alpha"))


def _by_pose(frames: tuple[Frame, ...]) -> list[list[Frame]]:
    groups: dict[str, list[Frame]] = {}
    for frame in frames:
        groups.setdefault(frame.pose_key, []).append(frame)
    return list(groups.values())


def _fill(mean: Tensor, seen: Array, atlas: Atlas) -> Tensor:
    """The texture (3, R, R) of values (3, N), unseen and uncovered texels set to the nearest seen one."""
    known = atlas.scatter(torch.from_numpy(seen)).numpy()
    row, column = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return atlas.scatter(mean)[:, torch.from_numpy(row.copy()), torch.from_numpy(column.copy())]
