"""Pinhole cameras: how points become pixels, and pixels rays.

OpenCV: x right, y down, z forward; pixel centres at +0.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from ..errors import InputError, Unsupported
from .arrays import Array, checked, put

_AHEAD = 1e-6  # metres in front of the camera from which on a projection makes sense as a box


class Box(NamedTuple):
    """Pixels with left <= x < right and top <= y < bottom."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def pixels(self) -> int:
        """How many there are; 0 for a box that is empty."""
        return (self.right - self.left) * (self.bottom - self.top)


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera: K (3, 3) in pixels, world_to_camera (3, 4) rigid, width and height in pixels.

    A place in the picture is (x, y) in pixels from the upper left corner, so the first pixel's centre is (0.5, 0.5).
    Depth is along the camera's z, in metres.
    """

    name: str
    width: int
    height: int
    K: Array
    world_to_camera: Array

    def __post_init__(self) -> None:
        owner = f"camera {self.name!r}"
        if self.width < 1 or self.height < 1:
            raise InputError(f"{owner}: size {self.width}x{self.height} must be at least 1x1")
        put(self, "K", checked(owner, "K", self.K, (3, 3), np.float64))
        put(self, "world_to_camera", checked(owner, "world_to_camera", self.world_to_camera, (3, 4), np.float64))
        if self.K[:, 2].tolist() == [0.0, 0.0, 1.0] and self.K[2, :2].any():
            raise InputError(f"{owner}: K is transposed: its last column is [0, 0, 1]; turn rows into columns")
        if abs(np.linalg.det(self.K)) < 1e-12:
            raise InputError(f"{owner}: K has no inverse; give focal lengths in pixels")
        if (last := self.K[2].tolist()) != [0.0, 0.0, 1.0]:
            raise InputError(f"{owner}: the last row of K is {last}, expected [0, 0, 1]; divide K by its last entry")
        if not np.allclose(self.rotation @ self.rotation.T, np.eye(3), atol=1e-4) or np.linalg.det(self.rotation) < 0:
            raise InputError(f"{owner}: world_to_camera is not a rigid transform; check its handedness and scale")

    @property
    def rotation(self) -> Array:
        """From directions in the world to directions in the camera's frame, (3, 3): `directions @ rotation.T`."""
        return self.world_to_camera[:, :3]

    @property
    def centre(self) -> Array:
        """Position of the camera in the world, (3,) metres."""
        return -self.rotation.T @ self.world_to_camera[:, 3]

    @property
    def ray_matrix(self) -> Array:
        """(3, 3): `[x, y, 1] @ ray_matrix` is the ray through a place (x, y), in the world, of length 1 along z."""
        return np.linalg.inv(self.K).T @ self.rotation

    def project(self, points: ArrayLike) -> tuple[Array, Array]:
        """The places (..., 2) in the picture of points (..., 3) in the world, and their depth (...,).

        A point that is not in front of the camera (depth <= 0) has no place: NaN.
        """
        seen = np.asarray(points) @ self.rotation.T + self.world_to_camera[:, 3]
        depth = seen[..., 2]
        ahead = (depth > 0.0)[..., None]
        places = np.where(ahead, (seen @ self.K.T)[..., :2], np.nan) / np.where(ahead, depth[..., None], 1.0)
        return places, depth

    def unproject(self, places: ArrayLike, depth: ArrayLike) -> Array:
        """The points (..., 3) in the world at places (..., 2) of the picture and a depth (...,); undoes `project`."""
        places = np.asarray(places)
        rays = np.concatenate([places, np.ones_like(places[..., :1])], axis=-1) @ np.linalg.inv(self.K).T
        return rays * np.asarray(depth)[..., None] @ self.rotation + self.centre

    def rays(self, supersample: int = 1, box: Box | None = None, dtype: DTypeLike = np.float64) -> Array:
        """Rays (height * s, width * s, 3) in the world through a regular s x s grid in each pixel (of a box, if given).

        Of length 1 along z, so that `centre + depth * ray` is the point at a depth; s = 1 are the pixels' centres.
        """
        left, top, right, bottom = box or self.whole
        by_row, by_column = self._ray_tables(supersample, dtype)
        across = by_column[left * supersample : right * supersample]
        return by_row[top * supersample : bottom * supersample, None] + across

    def pixel_rays(self, pixels: Array, supersample: int = 1, dtype: DTypeLike = np.float64) -> Array:
        """Those of `rays` that go through some pixels (P,), given as row * width + column: (P, s * s, 3)."""
        s, (by_row, by_column) = supersample, self._ray_tables(supersample, dtype)
        row, column = np.divmod(pixels, self.width)
        within_row = np.broadcast_to(by_row.reshape(self.height, s, 1, 3), (self.height, s, s, 3))
        within_column = np.broadcast_to(by_column.reshape(self.width, 1, s, 3), (self.width, s, s, 3))
        rays = within_row.reshape(self.height, -1).take(row, axis=0)
        rays += within_column.reshape(self.width, -1).take(column, axis=0)
        return rays.reshape(-1, s * s, 3)

    def _ray_tables(self, supersample: int, dtype: DTypeLike) -> tuple[Array, Array]:
        """What rows (height * s, 3) and columns (width * s, 3) contribute to a ray, which is linear in both."""
        across, along, middle = self.ray_matrix
        offset = (np.arange(supersample) + 0.5) / supersample
        columns, rows = ((np.arange(n)[:, None] + offset).reshape(-1, 1) for n in (self.width, self.height))
        return (rows * along + middle).astype(dtype), (columns * across).astype(dtype)

    @property
    def whole(self) -> Box:
        """All pixels."""
        return Box(0, 0, self.width, self.height)

    def box(self, points: Array) -> Box:
        """The pixels that a surface with corners (N, 3) in the world may cover, possibly none.

        All pixels if it reaches beside or behind the camera, where a projection has no box.
        """
        places, depth = self.project(points)
        if not (depth > _AHEAD).all():
            return self.whole
        low, high = np.floor(places.min(axis=0)), np.ceil(places.max(axis=0))
        (left, top), (right, bottom) = (np.clip(edge, 0, (self.width, self.height)).astype(int) for edge in (low, high))
        return Box(int(left), int(top), int(right), int(bottom))


class Uncalibrated(Camera):
    """A camera of which only name and size are told; whatever needs to know where it is raises `Unsupported`."""

    def __init__(self, name: str, width: int, height: int) -> None:
        for field, value in (("name", name), ("width", width), ("height", height)):
            put(self, field, value)

    @property
    def K(self) -> NoReturn:
        raise Unsupported(f"the calibration of camera {self.name!r} is not given")

    @property
    def world_to_camera(self) -> NoReturn:
        raise Unsupported(f"the calibration of camera {self.name!r} is not given")
