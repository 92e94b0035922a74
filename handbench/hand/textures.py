"""A texture of one hand model as one of another: from the nearest points of the surfaces, never from UV to UV."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ..errors import InputError
from ..lean import open3d
from ..render.uv.atlas import Atlas
from ..scene import Array, Mesh
from .conversion import converted
from .handmodel import HandModel


@dataclass(frozen=True, eq=False)
class ConvertedTexture:
    """texture (C, R, R) over the other model's UVs, zero where no chart is; distance (N,): metres that the surfaces are
    apart at its covered texels."""

    texture: Array
    distance: Array

    def __str__(self) -> str:
        mean, most = 1e3 * float(self.distance.mean()), 1e3 * float(np.percentile(self.distance, 95))
        return f"surfaces are apart by {mean:.1f} mm on average, 95 % of texels by less than {most:.1f} mm"


def converted_texture(texture: Array, source: HandModel, target: HandModel, size: int) -> ConvertedTexture:
    """A texture (C, R, R) over the UVs of `source` at a size and over the UVs of `target`.

    The neutral target takes the pose of the neutral source at rest as well as it can; each texel then shows what the
    nearest point of the source's surface does. Surfaces that can be subdivided are compared at level 1.
    Raises `InputError` for a texture that is no square.
    """
    texture = np.asarray(texture, np.float32)
    if texture.ndim != 3 or texture.shape[1] != texture.shape[2]:
        raise InputError(f"texture has shape {texture.shape}, expected (C, R, R)")
    rest, who = source.named_pose("rest"), source.neutral()
    found = converted(rest, who, source, target)
    own = source.mesh(who, rest, min(1, source.levels))
    theirs = target.mesh(found.shape, found.pose, min(1, target.levels))
    atlas = Atlas(theirs.topology, size)
    points = (theirs.vertices[theirs.topology.faces[atlas.face]] * atlas.barycentric[..., None]).sum(axis=1)
    face, barycentric, distance = _nearest(own, points)
    uvs, uv_faces = own.topology.unwrapped
    at = (uvs[uv_faces[face]] * barycentric[..., None]).sum(axis=1)
    made = np.zeros((len(texture), size * size), np.float32)
    made[:, atlas.texels] = _sampled(_filled(texture, own), at)
    return ConvertedTexture(made.reshape(-1, size, size), distance)


def _nearest(mesh: Mesh, points: Array) -> tuple[Array, Array, Array]:
    """Face, barycentric coordinates (N, 3) and distance of the nearest point of a mesh to each point (N, 3)."""
    o3d = open3d()
    scene, middle = o3d.t.geometry.RaycastingScene(), mesh.vertices.mean(axis=0)
    tensor = o3d.core.Tensor.from_numpy
    scene.add_triangles(
        tensor((mesh.vertices - middle).astype(np.float32)), tensor(mesh.topology.faces.astype(np.uint32))
    )
    found = scene.compute_closest_points(tensor((points - middle).astype(np.float32)))
    face, uv = found["primitive_ids"].numpy().astype(np.int64), found["primitive_uvs"].numpy().astype(np.float64)
    away = np.linalg.norm(found["points"].numpy() - (points - middle), axis=1)
    return face, np.concatenate([1.0 - uv.sum(axis=1, keepdims=True), uv], axis=1), away


def _filled(texture: Array, mesh: Mesh) -> Array:
    """The texture with what lies beside its charts taken from the nearest texel inside."""
    from scipy.ndimage import distance_transform_edt

    covered = Atlas.of(mesh.topology, texture.shape[1]).covered
    nearest = distance_transform_edt(~covered, return_distances=False, return_indices=True)
    filled: Array = texture[:, nearest[0], nearest[1]]
    return filled


def _sampled(texture: Array, uvs: Array) -> Array:
    """Bilinear values (C, N) of a texture at UVs (N, 2)."""
    grid = torch.from_numpy(np.stack([2 * uvs[:, 0] - 1, 1 - 2 * uvs[:, 1]], axis=-1).astype(np.float32))
    values = torch.nn.functional.grid_sample(
        torch.from_numpy(texture)[None], grid[None, None], mode="bilinear", padding_mode="border", align_corners=False
    )
    found: Array = values[0, :, 0].numpy()
    return found
