"""What a camera sees of a mesh: supersampled coverage, and texture lookup as one sparse matrix."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import torch
from scipy.sparse import csr_array
from torch import Tensor

from ...errors import InputError
from ...scene import Array, Camera, Mesh
from ...skips import note, skips
from ..uv.columns import at_corners, weighted
from .posedmesh import PosedMesh


class Raster:
    """The covered subsamples of an image, S in number.

    pixel (S,) flat index row * width + column, ascending; face (S,); barycentric (S, 3) float32; depth (S,) float32,
    metres along the camera's z. `uv` and `normal` are worked out when asked for, as trainings keep many rasters.
    Images drawn from it are premultiplied by coverage over black.
    """

    def __init__(self, mesh: PosedMesh, camera: Camera, supersample: int) -> None:
        self.mesh, self.camera, self.supersample = mesh, camera, supersample
        pixel, rays = _subsamples(mesh, camera, supersample)
        hits = mesh.rays.cast(camera.centre[None], rays)
        self.pixel: Array = pixel[hits.hit]
        self.face: Array = hits.face[hits.hit]
        self.barycentric: Array = hits.barycentric[hits.hit]
        self.depth: Array = hits.distance[hits.hit]  # the rays have length 1 along z
        self._lookups: dict[int, _Lookup] = {}

    @property
    def uv(self) -> Array:
        """UVs (S, 2) float64, origin bottom-left. Raises `Unsupported` for a mesh without UVs."""
        return self._at_samples(*self.mesh.topology.unwrapped)

    @property
    def normal(self) -> Array:
        """Smooth unit normals (S, 3) float64 in the world."""
        normal = self._at_samples(self.mesh.normals, self.mesh.topology.faces)
        return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)

    def _at_samples(self, values: Array, faces: Array) -> Array:
        """Values (V, C) that faces (F, 3) point to, at the samples: (S, C), each channel in one piece of memory."""
        return weighted(self.barycentric.T, at_corners(values, faces.take(self.face, axis=0))).T

    @cached_property
    def alpha(self) -> Array:
        """Coverage of the pixels, (H, W) float32 in [0, 1]."""
        count = np.bincount(self.pixel, minlength=self.camera.height * self.camera.width)
        return (count / self.supersample**2).astype(np.float32).reshape(self.camera.height, self.camera.width)

    def mean(self, values: Array) -> Array:
        """The premultiplied image (H, W, C) float32 of values (S, C) at the subsamples."""
        pixels = self.camera.height * self.camera.width
        sums = [np.bincount(self.pixel, column, minlength=pixels) for column in values.T]
        image = np.stack(sums, axis=-1) / self.supersample**2
        return image.astype(np.float32).reshape(self.camera.height, self.camera.width, -1)

    @cached_property
    def depth_map(self) -> Array:
        """Mean depth (H, W) float32 of each pixel's covered subsamples, metres along z; zero where there are none."""
        return self.mean(self.depth[:, None])[..., 0] / np.maximum(self.alpha, 1e-12)

    @cached_property
    def normal_map(self) -> Array:
        """Mean direction (H, W, 3) float32 of each pixel's smooth normals, unit, in the world; zero where none."""
        normal = self.mean(self.normal)
        return normal / np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-12)

    def attribute(self, attribute: Array) -> Array:
        """The premultiplied image (H, W, C) of a vertex attribute (V, C)."""
        return self.mean(self._at_samples(attribute, self.mesh.topology.faces))

    def sample(self, texture: Tensor) -> Tensor:
        """The premultiplied image (C, H, W) of a square texture (C, R, R), bilinear; differentiable in the texture.

        Lookups near the border of a chart touch texels outside it: dilate the texture first (`Atlas.dilate`).
        """
        if texture.ndim != 3 or texture.shape[1] != texture.shape[2] or not texture.numel():
            raise InputError(f"texture has shape {tuple(texture.shape)}, expected (C, R, R)")
        lookup = self._lookup(texture.shape[1])
        if texture.device.type == "cpu":
            image = _Gather.apply(texture.flatten(1), lookup)
        else:
            image = lookup.image(texture.flatten(1))
        return image.unflatten(1, (self.camera.height, self.camera.width))

    def texels(self, size: int) -> Array:
        """Which texels of a size x size texture, (size * size,) bool row by row, `sample` looks up."""
        touched = np.zeros(size * size, dtype=bool)
        touched[self._lookup(size).forward.indices] = True
        return touched

    def _lookup(self, size: int) -> _Lookup:
        """The lookup at a texture size; kept."""
        known = size in self._lookups
        note("texture lookups", 1, known)
        if not known:
            self._lookups[size] = self._new_lookup(size)
        return self._lookups[size]

    def _new_lookup(self, size: int) -> _Lookup:
        """The sparse matrix from texels to seen pixels."""
        u, v = self.uv.T
        x, y = u * size - 0.5, (1.0 - v) * size - 0.5
        left, top = np.floor(x), np.floor(y)
        right_share, bottom_share = x - left, y - top
        columns, rows = (
            [np.clip(first + step, 0, size - 1).astype(np.int32) for step in (0, 1)] for first in (left, top)
        )
        texels, weights = np.empty((len(u), 4), np.int32), np.empty((len(u), 4), np.float32)
        for down, weight_y in ((0, 1.0 - bottom_share), (1, bottom_share)):
            for right, weight_x in ((0, 1.0 - right_share), (1, right_share)):
                texels[:, 2 * down + right] = rows[down] * size + columns[right]
                weights[:, 2 * down + right] = weight_y * weight_x / self.supersample**2
        samples = np.bincount(self.pixel, minlength=self.camera.height * self.camera.width)
        pixels = np.flatnonzero(samples)
        ends = 4 * np.append(0, samples[pixels].cumsum())  # samples are in the order of their pixels
        matrix = csr_array((weights.ravel(), texels.ravel(), ends), shape=(len(pixels), size * size))
        matrix.sum_duplicates()
        return _Lookup(matrix, torch.from_numpy(pixels), self.camera.height * self.camera.width)


class _Lookup:
    """A sparse matrix (P, R*R) from texels to the P pixels that see the mesh."""

    def __init__(self, matrix: csr_array, pixels: Tensor, count: int) -> None:
        self.forward = matrix
        self.pixels, self.count = pixels, count
        self._moved: dict[torch.device, tuple[Tensor, Tensor]] = {}

    @cached_property
    def backward(self) -> csr_array:
        """The transpose, which only gradients need."""
        return self.forward.T.tocsr()

    def image(self, texture: Tensor) -> Tensor:
        """The image (C, H*W) of a texture (C, R*R) on its device, by torch's sparse product: scipy's is the CPU's."""
        if texture.device not in self._moved:
            rows, texels, weights = (torch.from_numpy(part) for part in _triplets(self.forward))
            matrix = torch.sparse_coo_tensor(
                torch.stack([rows, texels]), weights, self.forward.shape, check_invariants=False
            )
            self._moved[texture.device] = matrix.to(texture.device).coalesce(), self.pixels.to(texture.device)
        matrix, pixels = self._moved[texture.device]
        seen = torch.sparse.mm(matrix, texture.float().T).T.to(texture.dtype)
        return texture.new_zeros(texture.shape[0], self.count).index_copy(1, pixels, seen)


def _triplets(matrix: csr_array) -> tuple[Array, Array, Array]:
    """Row, column (int64) and value of each entry."""
    entries = matrix.tocoo()
    return entries.row.astype(np.int64), entries.col.astype(np.int64), entries.data


class _Gather(torch.autograd.Function):
    """texture (C, R*R) -> image (C, H*W) by a sparse matrix; the gradient goes through its transpose."""

    @staticmethod
    def forward(ctx: Any, texture: Tensor, lookup: _Lookup) -> Tensor:
        ctx.lookup = lookup
        seen = torch.from_numpy(lookup.forward @ np.ascontiguousarray(texture.detach().float().numpy().T))
        image = texture.new_zeros(texture.shape[0], lookup.count)
        return image.index_copy_(1, lookup.pixels, seen.T.to(texture.dtype))

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        seen = gradient.index_select(1, ctx.lookup.pixels).float().T.contiguous().numpy()
        return torch.from_numpy(np.ascontiguousarray((ctx.lookup.backward @ seen).T)).to(gradient.dtype), None


def rasterise(mesh: Mesh | PosedMesh, camera: Camera, supersample: int = 3) -> Raster:
    """The mesh through the camera, supersample^2 rays a pixel on a regular grid.

    Only pixels in the projected boxes of triangles get rays (`Skips.outside_box`).
    Raises `InputError` for a supersample below 1.
    """
    if supersample < 1:
        raise InputError(f"supersample {supersample} must be at least 1")
    return Raster(PosedMesh.of(mesh), camera, supersample)


def _subsamples(mesh: PosedMesh, camera: Camera, supersample: int) -> tuple[Array, Array]:
    """Pixel (M,) and ray (M, 3) in the world, of length 1 along z, of the subsamples that may see the mesh, pixel by
    pixel."""
    whole = camera.whole.pixels
    pixels = np.arange(whole)
    if skips().outside_box:
        pixels = _near(mesh, camera)
    note("camera rays", whole * supersample**2, (whole - len(pixels)) * supersample**2)
    return pixels.repeat(supersample**2), camera.pixel_rays(pixels, supersample, np.float32).reshape(-1, 3)


_MARGIN = 0.05
"""Pixels around a triangle's box, for the rounding of rays."""


def _near(mesh: PosedMesh, camera: Camera) -> Array:
    """The pixels (P,) that the box of any triangle touches: rays through others meet nothing."""
    height, width = camera.height, camera.width
    places, _ = camera.project(mesh.vertices)
    if not np.isfinite(places).all():  # beside or behind the camera a triangle has no box
        return np.arange(height * width)
    corners = at_corners(places, mesh.topology.faces)
    size = np.array([[width], [height]])
    first = np.clip(np.floor(np.minimum.reduce(corners) - _MARGIN), 0, size).astype(np.int64)
    after = np.clip(np.floor(np.maximum.reduce(corners) + _MARGIN) + 1, 0, size).astype(np.int64)
    (left, top), (right, bottom) = first, after
    # boxes are counted by the corners at which they begin and end: sums along both axes give how many hold a pixel
    counts = np.zeros((height + 1) * (width + 1), dtype=np.int64)
    for row, column, sign in ((top, left, 1), (top, right, -1), (bottom, left, -1), (bottom, right, 1)):
        counts += sign * np.bincount(row * (width + 1) + column, minlength=len(counts))
    held = counts.reshape(height + 1, width + 1).cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0
    return np.flatnonzero(held)
