"""Soft visibility from shadow maps, as the released URHand code computes it (goliath, `ca_code/utils/shadowmap.py`).

A texel's depth as the light sees it is compared with a depth map: V = exp(-d / 8 mm), where d is how far the texel
lies behind what the light sees first. It is no penumbra of a real light; it is what URHand's networks are fed.
"""

from __future__ import annotations

import numpy as np

from ...errors import InputError
from ...scene import Array, Mesh
from ...skips import note, skips
from ..uv.atlas import Atlas
from .posedmesh import PosedMesh
from .rays import RayScene

SIZE = 1024
"""Texels along a depth map's longer side."""

SOFTNESS = 8e-3
"""Metres behind the first surface at which a texel gets 1/e of the light."""

BEHIND = 1.0
"""Metres behind the first surface that a texel counts for which faces away: the released code's 1e3 mm."""

FACING = 10.0
"""Slope of the sigmoid that tells what faces the light."""

_DARK = 0.2  # n.ω up to which (1 - sigmoid(10 n.ω)) 1 m alone leaves less than 4e-7
_SIGMA = 0.8  # of the taps, in texels: 0.3 ((3 - 1) / 2 - 1) + 0.8
_TAPS = np.array([(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1)])
_WEIGHTS = np.exp(-(_TAPS**2).sum(axis=1) / (2 * _SIGMA**2)).astype(np.float32)
_BESIDE = 1.5  # radii of the mesh from its middle, within which a light gets no map
_FAR = 1e3  # radii beyond which its rays count as parallel: float32 depths from a light farther off lose millimetres


def soft_visibility(
    mesh: Mesh | PosedMesh,
    atlas: Atlas,
    directions: Array,
    positions: Array | None = None,
    texels: Array | None = None,
    size: int = SIZE,
) -> Array:
    """How much of distant lights and near ones covered texels see, float32 (L + P, N): see `SoftShadows.visible`."""
    return SoftShadows(PosedMesh.of(mesh), atlas, size).visible(directions, positions, texels)


class SoftShadows:
    """The soft shadows that a posed mesh casts on itself, for one light after the other.

    Depth maps have at most `size` x `size` texels, fitted to the mesh as the light sees it. Raises `InputError` for a
    size below 8.
    """

    def __init__(self, mesh: PosedMesh, atlas: Atlas, size: int = SIZE) -> None:
        if size < 8:
            raise InputError(f"shadow maps of {size} texels a side are too small; give at least 8")
        self._scene, self._size = mesh.rays, size
        # positions from the scene's centre and smooth unit normals, both (N, 3)
        self._points = atlas.interpolate(mesh.vertices - self._scene.centre).astype(np.float32)
        normals = atlas.interpolate(mesh.normals)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        self._normals = normals.astype(np.float32)

    def visible(self, directions: Array, positions: Array | None = None, texels: Array | None = None) -> Array:
        """How much of distant lights (L, 3) and near ones at positions (P, 3) covered texels see: float32 (L + P, N).

        V = exp(-(s d + (1 - s) 1 m) / 8 mm) with s = sigmoid(10 n.ω) for the smooth normal n, and d the mean of
        max(0, texel's depth - map's depth) over the 3 x 3 map texels around it, weighted by a Gaussian; those that
        show no surface are left out. Lengths are absolute: the mesh must be in metres. `texels` (N,) picks from the
        atlas's covered ones.

        Distant lights use an orthographic map, since their rays are parallel: the released code knows only lights at
        a position. Near lights use a perspective one that looks at the middle of the mesh, beyond a thousand radii an
        orthographic one. A light too near for that, inside or beside the mesh, compares each texel with the first
        surface on the line to it, without neighbours.

        With `Skips.below_horizon` pairs with n.ω <= 0.2 are zero without a look; they would be below 4e-7. Says how
        many pairs it skipped as "shadow rays".
        """
        scene, points, normals, size = self._scene, self._points, self._normals, self._size
        near = np.zeros((0, 3)) if positions is None else np.asarray(positions, dtype=np.float64) - scene.centre
        lights = np.concatenate([directions, near]).astype(np.float32)
        chosen = np.arange(len(points)) if texels is None else texels
        visible = np.zeros((len(lights), len(chosen)), dtype=np.float32)
        looked = 0
        for row, light in enumerate(lights):
            distant = row < len(directions)
            cosine = normals[chosen] @ light if distant else _near_cosine(points[chosen], normals[chosen], light)
            bright = np.flatnonzero(cosine > (_DARK if skips().below_horizon else -np.inf))
            some = chosen[bright]
            looked += len(some)
            if distant:
                behind = _behind(_Orthographic(scene, light), points, some, size)
            elif (away := np.linalg.norm(light)) > _FAR * scene.radius:
                behind = _behind(_Orthographic(scene, light / away), points, some, size)
            elif away > _BESIDE * scene.radius:
                behind = _behind(_Perspective(scene, light), points, some, size)
            else:
                behind = _straight(scene, light, points[some])
            averted = 1.0 / (1.0 + np.exp(FACING * cosine[bright]))  # 1 - s without cancellation
            visible[row, bright] = np.exp(-((1.0 - averted) * behind + averted * BEHIND) / SOFTNESS)
        note("shadow rays", visible.size, visible.size - looked)
        return visible


def _near_cosine(points: Array, normals: Array, light: Array) -> Array:
    towards = light - points
    length = np.maximum(np.linalg.norm(towards, axis=1), np.finfo(np.float32).tiny)
    return np.einsum("nc,nc->n", normals, towards) / length


class _Orthographic:
    """The depth camera of a distant light. Its plane goes through the scene's centre."""

    def __init__(self, scene: RayScene, direction: Array) -> None:
        self._scene, self._frame = scene, _frame(-direction)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Where points (N, 3) appear (N, 2), in metres, and their depth (N,)."""
        seen = points @ self._frame.T
        return seen[:, :2], seen[:, 2]

    def depth(self, where: Array) -> Array:
        """Depth (N,) of the first surface at places (N, 2), inf where there is none."""
        start = -1.01 * self._scene.radius
        rays = np.empty((len(where), 6), dtype=np.float32)
        rays[:, :3] = where @ self._frame[:2] + start * self._frame[2]
        rays[:, 3:] = self._frame[2]
        return self._scene.distances(rays) + np.float32(start)


class _Perspective:
    """The depth camera of a near light; it looks at the scene's centre from outside of the scene's ball."""

    def __init__(self, scene: RayScene, position: Array) -> None:
        self._scene, self._position, self._frame = scene, position, _frame(-position)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Where points (N, 3) appear (N, 2), in units of the distance, and their depth (N,)."""
        seen = (points - self._position) @ self._frame.T
        return seen[:, :2] / seen[:, 2:], seen[:, 2]

    def depth(self, where: Array) -> Array:
        """Depth (N,) of the first surface at places (N, 2), inf where there is none."""
        rays = np.empty((len(where), 6), dtype=np.float32)
        rays[:, :3] = self._position
        rays[:, 3:] = where @ self._frame[:2] + self._frame[2]  # 1 along the depth
        return self._scene.distances(rays)


def _frame(forward: Array) -> Array:
    """Rows x, y, z of a right-handed frame whose z is `forward`."""
    z = forward / np.linalg.norm(forward)
    x = np.cross(z, np.eye(3, dtype=np.float32)[np.abs(z).argmin()])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z]).astype(np.float32)


def _behind(camera: _Orthographic | _Perspective, points: Array, some: Array, size: int) -> Array:
    """How far the chosen ones of points (N, 3) lie behind the map's surface: the mean over the 3 x 3 taps."""
    where, depth = camera.project(points)
    low = where.min(axis=0)
    pitch = max(float(np.ptp(where, axis=0).max()), 1e-12) / (size - 3)  # leaves a border of one for the taps
    column, row = ((where[some] - low) / pitch).astype(np.int64).T + 1
    taps = (row + _TAPS[:, :1]) * size + column + _TAPS[:, 1:]  # (9, M)
    # only map texels that are looked up are cast: a tenth of a large map
    needed = np.zeros(size * size, dtype=bool)
    needed[taps] = True
    places = np.flatnonzero(needed)
    centres = np.stack([places % size, places // size], axis=1) - np.float32(0.5)
    surface = np.empty(size * size, dtype=np.float32)
    surface[places] = camera.depth((low + pitch * centres).astype(np.float32))
    surface = surface[taps]
    weight = _WEIGHTS[:, None] * np.isfinite(surface)
    difference = np.maximum(depth[some] - surface, 0.0)  # nothing behind: minus infinity, so 0
    return (weight * difference).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-6)


def _straight(scene: RayScene, light: Array, points: Array) -> Array:
    """How far points (M, 3) lie behind the first surface on the line from a light to them."""
    towards = points - light
    rays = np.concatenate([np.broadcast_to(light, towards.shape), towards], axis=1)
    before = np.maximum(1.0 - scene.distances(np.ascontiguousarray(rays)), 0.0)
    return before * np.linalg.norm(towards, axis=1)
