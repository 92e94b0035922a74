"""Hard shadows: which lights each texel sees."""

from __future__ import annotations

import numpy as np

from ...scene import Array, Mesh
from ...skips import note, skips
from ..uv.atlas import Atlas
from ..uv.columns import at_corners, inner, unit_columns, weighted
from ..uv.surface import face_normals
from .posedmesh import PosedMesh

VERSION = 4
"""Of the answers here and in `shadowmap`: raise it when they change, so that shadows kept on disk are made again."""

HORIZON = 0.1
"""Pairs with n.ω below minus this are not traced: normals refined by millimetre displacements tilt a little."""

_STEPS = (4, 2)
"""Distances in texels between those that are asked whether they agree, coarse to fine. With 8 before them the error of
a picture under an environment rises by half; with 2 alone it is as with both."""

_RAYS = 1 << 19
"""Rays traced at once: 12 MB."""


def visibility(
    mesh: Mesh | PosedMesh,
    atlas: Atlas,
    directions: Array,
    positions: Array | None = None,
    texels: Array | None = None,
) -> Array:
    """Whether covered texels see distant lights and near ones, bool (L + P, N): see `HardShadows.visible`."""
    return HardShadows(PosedMesh.of(mesh), atlas).visible(directions, positions, texels)


class HardShadows:
    """The shadows that a posed mesh casts on itself, for one light after the other.

    Where shadow rays start is worked out once, for all lights.
    """

    def __init__(self, mesh: PosedMesh, atlas: Atlas) -> None:
        self._scene, self._atlas = mesh.rays, atlas
        self._origins = _shadow_origins(mesh, atlas)

    def visible(
        self,
        directions: Array,
        positions: Array | None = None,
        texels: Array | None = None,
        fill: bool = False,
    ) -> Array:
        """Whether covered texels see distant lights (L, 3) and near ones at positions (P, 3): bool (L + P, N).

        `directions` are unit vectors to the distant lights. `texels` (N,) picks from the atlas's covered ones.

        With `Skips.below_horizon`, pairs below the horizon of the smooth normal are not traced and count as unseen:
        those with n.ω <= -`HORIZON`, and those with n.ω <= 0 where the mesh does not bulge over the texel's triangle,
        so that nothing but an open border could let light through. Pairs with n.ω > 0 do not depend on the switch.
        Says how many pairs it skipped as "shadow rays".

        With `fill` and `Skips.agreed`, distant lights are traced at every fourth texel of both directions first, then
        at every other, then at all: but where those around a texel that were there before agree, it is taken to see
        what they see. What is narrower than a few texels can be missed, so this is for sums over many lights. What a
        texel sees does not depend on which others are asked for: those around it are asked, too.
        """
        starts, normals, reach = self._origins
        texels = np.arange(len(starts)) if texels is None else texels
        asked, stages = texels, list[tuple[Array, Array]]()
        if fill and skips().agreed:
            asked, stages = _with_those_around(texels, _stages(self._atlas))
        starts, normals, reach = starts[asked], normals[asked], reach[asked]
        if not skips().below_horizon:
            reach = np.full_like(reach, 2.0)
        scene = self._scene
        near = np.zeros((0, 3)) if positions is None else np.asarray(positions, dtype=np.float64)
        seen = np.zeros((len(directions) + len(near), len(starts)), dtype=bool)
        traced = 0
        step = max(1, _RAYS // max(1, len(starts)))
        for first in range(0, len(directions), step):
            some = np.asarray(directions[first : first + step], dtype=np.float32)
            facing = some @ normals.T > -reach
            found = seen[first : first + len(some)]
            if not stages:
                traced += self._trace(starts, some, facing, found)
            for chosen, corners in stages:
                answers = facing.take(chosen, axis=1)
                unsure = answers.copy()
                if len(corners):
                    votes = np.add.reduce([found.take(corner, axis=1) for corner in corners], dtype=np.int8)
                    answers &= votes > 0
                    unsure = answers & (votes < len(corners))
                traced += self._trace(starts[chosen], some, unsure, answers)
                found[:, chosen] = answers
        for row, position in enumerate(near, start=len(directions)):
            towards = (position - scene.centre).astype(np.float32) - starts
            facing = np.einsum("nc,nc->n", towards, normals) > -reach * np.linalg.norm(towards, axis=1)
            # rays run from the texel (0) to the light (1)
            rays = np.concatenate([starts[facing], towards[facing]], axis=1)
            seen[row, facing] = ~scene.blocked(rays, far=1.0)
            traced += len(rays)
        note("shadow rays", seen.size, seen.size - traced)
        return seen[:, np.searchsorted(asked, texels)] if stages else seen

    def _trace(self, starts: Array, directions: Array, pairs: Array, seen: Array) -> int:
        """Set what distant lights are seen at some pairs (L, N), and say how many rays that took."""
        rays = _shadow_rays(starts, directions, pairs)
        seen[pairs] = ~self._scene.blocked(rays)
        return len(rays)


def _stages(atlas: Atlas) -> list[tuple[Array, Array]]:
    """Covered texels that are between no others, without corners, then those between others, coarse to fine."""
    between = [around_texels(atlas, step) for step in _STEPS]
    alone = np.ones(atlas.count, dtype=bool)
    for texels, _ in between:
        alone[texels] = False
    return [(np.flatnonzero(alone), np.zeros((0, 0), dtype=np.int64)), *between]


def _with_those_around(texels: Array, stages: list[tuple[Array, Array]]) -> tuple[Array, list[tuple[Array, Array]]]:
    """Texels and those that they ask, rising, and the stages of these alone, as places among them."""
    asked = np.zeros(sum(len(between) for between, _ in stages), dtype=bool)
    asked[texels] = True
    for between, corners in reversed(stages):  # the coarser ones are asked by the finer
        if len(corners):
            asked[corners[:, asked[between]]] = True
    place = np.cumsum(asked) - 1
    kept = [asked[between] for between, _ in stages]
    return np.flatnonzero(asked), [
        (place[between[some]], place[corners[:, some]] if len(corners) else corners)
        for (between, corners), some in zip(stages, kept, strict=True)
    ]


def around_texels(atlas: Atlas, step: int) -> tuple[Array, Array]:
    """Which covered texels lie between others, (M,), and those others, (4, M), by their numbers in the atlas.

    The others are texels of the same chart whose row and column are multiples of `step`, an even number; those between
    are of multiples of its half. In line with two of the others they have these twice. Texels that lack one of theirs
    are not between others.
    """
    size = atlas.size
    row, column = np.divmod(atlas.texels, size)
    down, right = row % step, column % step
    place = np.full((size + step, size + step), -1)  # beyond the last row and column there is nothing
    on = (down == 0) & (right == 0)
    place[row[on], column[on]] = np.flatnonzero(on)
    corners = np.stack([place[row + y * down, column + x * right] for y in (-1, 1) for x in (-1, 1)])
    between = ~on & (down % (step // 2) == 0) & (right % (step // 2) == 0)
    between &= (corners >= 0).all(axis=0) & (atlas.chart[corners] == atlas.chart).all(axis=0)
    return np.flatnonzero(between), corners[:, between]


def _shadow_rays(starts: Array, directions: Array, facing: Array) -> Array:
    """Rays (M, 6) from starts (N, 3) along directions (L, 3) for the M true pairs of facing (L, N), in its order."""
    padded = np.concatenate([starts, np.zeros_like(starts)], axis=1)
    rays = np.empty((np.count_nonzero(facing), 6), dtype=np.float32)
    end = 0
    for direction, row in zip(directions, facing, strict=True):
        texels = np.flatnonzero(row)
        start, end = end, end + len(texels)
        # take() into place is four times faster than indexing, which would copy twice
        np.take(padded, texels, axis=0, out=rays[start:end], mode="clip")
        rays[start:end, 3:] = direction
    return rays


def _shadow_origins(mesh: PosedMesh, atlas: Atlas) -> tuple[Array, Array, Array]:
    """Where shadow rays start from the scene's centre (N, 3), the smooth normals there (N, 3), and the sine (N,)
    below the horizon up to which rays are worth tracing; all float32.

    A point on a flat triangle is hidden by its neighbours from lights that the smooth surface sees, which
    draws the triangles along the terminator. So a start is lifted to the planes tangent at the triangle's
    vertices (Hanika, "Hacking the Shadow Terminator", Ray Tracing Gems II, ch. 4), then off the triangle
    by the scene's epsilon. Starts that are lifted see a little over the horizon, others do not.
    """
    scene, corners = mesh.rays, mesh.topology.faces[atlas.face]
    weights = np.ascontiguousarray(atlas.barycentric.T)
    places, normals = at_corners(mesh.vertices - scene.centre, corners), at_corners(mesh.normals, corners)
    point, smooth = weighted(weights, places), unit_columns(weighted(weights, normals))
    heights = np.stack([inner(point - place, normal) for place, normal in zip(places, normals, strict=True)])
    lift = weighted(-np.minimum(heights, 0.0) * weights, normals)
    above = scene.epsilon * face_normals(mesh.vertices, mesh.topology.faces)[atlas.face]
    reach = np.where(np.sqrt(inner(lift, lift)) > scene.epsilon, HORIZON, 0.0)
    return ((point + lift).T + above).astype(np.float32), smooth.T.astype(np.float32), reach.astype(np.float32)
