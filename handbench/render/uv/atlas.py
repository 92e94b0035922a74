"""The UV atlas: which point of the surface a texel shows.

Texture maps are (..., C, R, R), row 0 = top: texel (i, j) is centred at u = (j + 1/2)/R, v = 1 - (i + 1/2)/R.
A texel is covered if its centre lies in a UV triangle; flat maps (..., C, N) hold the covered texels only,
row by row.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from functools import cached_property

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from ...errors import InputError
from ...scene import Array, Topology
from ...skips import skips
from ..see.rays import RayScene
from .columns import at_corners, weighted

# An atlas depends on nothing but the topology, which all poses of all subjects of a capture share.
_KEPT = 16
_recent: OrderedDict[tuple[str, int, bool], Atlas] = OrderedDict()
_lock = threading.Lock()


class Atlas:
    """Where the R x R texels of a texture lie on a mesh of a given topology.

    covered (R, R) bool; texels (N,) flat indices of the covered ones; face (N,), barycentric (N, 3) float64,
    chart (N,) the island of each covered texel.

    With `copies` there are N = R x R texels: what is not covered is worked on too, as a copy of its nearest covered
    texel, whose index `texels` then repeats. Maps and pictures are the same; it is what `Skips.uncovered` saves.
    """

    def __init__(self, topology: Topology, size: int, copies: bool = False) -> None:
        if size < 1:
            raise InputError(f"texture size {size} must be at least 1")
        self.topology = topology
        self.size = size
        centre = (np.arange(size) + 0.5) / size
        points = np.stack([*np.meshgrid(centre, 1.0 - centre), np.ones((size, size))], axis=-1).reshape(-1, 3)
        uvs, uv_faces = topology.unwrapped
        flat = np.concatenate([uvs, np.zeros((len(uvs), 1))], axis=1)
        hits = RayScene(flat, uv_faces).cast(points, np.array([[0.0, 0.0, -1.0]]))
        self.covered: Array = hits.hit.reshape(size, size)
        self.texels: Array = np.flatnonzero(hits.hit)
        self.face: Array = hits.face[hits.hit]
        self.barycentric: Array = hits.barycentric[hits.hit].astype(np.float64)
        if len(self.texels) == 0:
            raise InputError(f"no texel of a {size}x{size} texture is covered by the UVs; check the mesh's UVs")
        self._originals: Tensor | None = None
        self._moved: dict[tuple[str, torch.device], tuple[Tensor, ...]] = {}
        if copies:
            self._originals = torch.from_numpy(self.texels)
            copied = np.cumsum(hits.hit)[self._nearest[0].numpy()] - 1
            self.texels, self.face, self.barycentric = (v[copied] for v in (self.texels, self.face, self.barycentric))

    @staticmethod
    def of(topology: Topology, size: int) -> Atlas:
        """The atlas of a topology and size; the last few are kept by the topology's content. See `Skips.uncovered`."""
        copies = not skips().uncovered
        key = (topology.digest, size, copies)
        with _lock:
            found = _recent.pop(key, None)
        found = found or Atlas(topology, size, copies)
        with _lock:
            _recent[key] = found  # the last one now
            while len(_recent) > _KEPT:
                _recent.popitem(last=False)
        return found

    @property
    def count(self) -> int:
        """Number N of texels that are worked on."""
        return len(self.texels)

    @cached_property
    def chart(self) -> Array:
        """The island of each covered texel, (N,) int."""
        uvs, faces = self.topology.unwrapped
        edges = np.concatenate([faces[:, :2], faces[:, 1:]])
        count = len(uvs)
        graph = coo_array((np.ones(len(edges), dtype=bool), (edges[:, 0], edges[:, 1])), shape=(count, count))
        return connected_components(graph, directed=False)[1][faces[self.face, 0]]

    def neighbours(self, device: torch.device) -> tuple[Tensor, ...]:
        """For each covered texel the flat index (N,) of its right, left, upper and lower neighbour in the same chart,
        or its own."""
        return self._on("_neighbours", device)

    def _on(self, name: str, device: torch.device) -> tuple[Tensor, ...]:
        """Index tensors on a device, moved there once."""
        held: tuple[Tensor, ...] = getattr(self, name)
        if device.type == "cpu":
            return held
        if (name, device) not in self._moved:
            self._moved[name, device] = tuple(tensor.to(device) for tensor in held)
        return self._moved[name, device]

    @cached_property
    def _neighbours(self) -> tuple[Tensor, ...]:
        own = np.arange(self.count)
        where = np.full((self.size + 2, self.size + 2), -1)  # padded by one texel, so borders need no special case
        row, column = self.texels // self.size + 1, self.texels % self.size + 1
        where[row, column] = own

        def neighbour(down: int, right: int) -> Tensor:
            other = where[row + down, column + right]
            same = (other >= 0) & (self.chart[other] == self.chart)
            return torch.from_numpy(np.where(same, other, own))

        return neighbour(0, 1), neighbour(0, -1), neighbour(-1, 0), neighbour(1, 0)

    @cached_property
    def nearest_fourth(self) -> Array:
        """For each covered texel the nearest in every fourth row and column, (N,), or itself if that is of another
        chart."""
        row, column = np.divmod(self.texels, self.size)
        own, fourth = np.arange(self.count), (row % 4 == 0) & (column % 4 == 0)
        place = np.full((self.size, self.size), -1)
        place[row[fourth], column[fourth]] = own[fourth]
        if not fourth.any():
            return own
        near_row, near_column = distance_transform_edt(place < 0, return_distances=False, return_indices=True)
        found = place[near_row, near_column][row, column]
        return np.where(self.chart[found] == self.chart, found, own)

    @cached_property
    def _indices(self) -> tuple[Tensor, Tensor]:
        """The covered texels that are worked on, and those that are written: without copies the same."""
        worked = torch.from_numpy(self.texels)
        return worked, worked if self._originals is None else self._originals

    @cached_property
    def _nearest(self) -> tuple[Tensor, Tensor]:
        """The nearest covered texel (R*R,) of each texel and the distance to it in texels (R*R,)."""
        distance, (row, column) = distance_transform_edt(~self.covered, return_indices=True)
        return torch.from_numpy((row * self.size + column).ravel().astype(np.int64)), torch.from_numpy(distance.ravel())

    def interpolate(self, attribute: Array) -> Array:
        """A vertex attribute (V, C) at the covered texels, (N, C)."""
        values = weighted(self.barycentric.T, at_corners(attribute, self.topology.faces[self.face]))
        return np.ascontiguousarray(values.T)

    def gather(self, texture: Tensor) -> Tensor:
        """The covered texels (..., N) of maps (..., R, R); differentiable."""
        return _select(texture.flatten(-2), self._on("_indices", texture.device)[0])

    def scatter(self, values: Tensor) -> Tensor:
        """Maps (..., R, R) of values (..., N) at the covered texels, zero elsewhere; differentiable."""
        lead, index = values.shape[:-1], self._on("_indices", values.device)[1]
        if self._originals is not None:  # copies are dropped
            values = _select(values, index)
        blank = values.new_zeros(math.prod(lead), self.size * self.size)
        return blank.index_copy(1, index, values.reshape(len(blank), -1)).reshape(*lead, self.size, self.size)

    def dilate(self, texture: Tensor, texels: int | None = None) -> Tensor:
        """Maps (..., R, R) with each uncovered texel set to its nearest covered one; differentiable.

        So a bilinear lookup at the border of a chart mixes no background in. `texels` limits the reach
        (texels farther away become zero); None fills everything.
        """
        nearest, distance = self._on("_nearest", texture.device)
        filled = _select(texture.flatten(-2), nearest)
        if texels is not None:
            filled = filled * (distance <= texels)
        return filled.unflatten(-1, (self.size, self.size))

    def needed(self, looked_up: Array) -> Array:
        """Which texels (N,) bool a lookup of some texels (R*R,) bool of a dilated map depends on."""
        sources = np.zeros(self.size * self.size, dtype=bool)
        sources[self._nearest[0].numpy()[looked_up]] = True
        return sources[self.texels]


def forget() -> None:
    """Let go of the atlases that are kept."""
    with _lock:
        _recent.clear()


def _select(values: Tensor, index: Tensor) -> Tensor:
    """Values (..., S) at an index (N,) of their last axis, as a matrix: index_select is 20 times slower else."""
    return values.reshape(-1, values.shape[-1]).index_select(1, index).reshape(*values.shape[:-1], len(index))
