"""Does a posed hand run through itself? Part against part, with signed distances."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components

from ..lean import open3d
from ..scene import Pose
from .handmodel import HandModel

LEVEL = 1  # of the surface that is tested; coarse vertices alone miss what dips between them
TOLERANCE = 0.002  # metres: skin that touches is pressed in by about as much


@dataclass(frozen=True)
class Penetration:
    """depth: deepest vertex inside another part, metres; count: vertices deeper than `TOLERANCE`."""

    depth: float
    count: int

    @property
    def free(self) -> bool:
        return self.count == 0


def _parts(hand: HandModel) -> list[str]:
    """The rigid part of each joint: forearm, palm (wrist and metacarpals), or a phalanx such as "index1"."""
    parts = ["palm"] * len(hand.parents)
    above = hand.parents[hand.wrist]
    while above >= 0:
        parts[above], above = "forearm", hand.parents[above]
    for finger, chain in zip(hand.fingers, hand.chains, strict=True):
        for number, joint in enumerate(chain, start=1):
            parts[joint] = f"{finger}{number}"
    return parts


def _adjacent(a: str, b: str) -> bool:
    """Parts that meet at a joint, where the skin folds rather than collides; knuckles of neighbours share a web."""
    if a == b or "forearm" in (a, b):
        return True
    if "palm" in (a, b):
        return (b if a == "palm" else a)[-1] == "1"
    same_finger = a[:-1] == b[:-1]
    return (same_finger and abs(int(a[-1]) - int(b[-1])) == 1) or (a[-1] == b[-1] == "1")


def _across(faces: NDArray[Any]) -> NDArray[Any]:
    """The face beyond each side of a face, (F, 3): corner 0 to 1, 1 to 2, 2 to 0; F where there is none."""
    start, end = faces.ravel(), faces[:, [1, 2, 0]].ravel()
    count = int(faces.max()) + 1
    sides, wanted = start * count + end, end * count + start
    order = np.argsort(sides)
    at = order[np.minimum(np.searchsorted(sides, wanted, sorter=order), len(sides) - 1)]
    return np.where(sides[at] == wanted, at // 3, len(faces)).reshape(faces.shape)


def _cap(patch: NDArray[Any], across: NDArray[Any], faces: NDArray[Any], vertices: NDArray[Any]) -> tuple[Any, Any]:
    """Close a patch (F,) of a surface's faces: each border loop gets a fan round its mean.

    Returns the fans' triangles and all vertices.
    """
    edges = faces[patch][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    count = len(vertices)
    border = edges[~np.append(patch, False)[across[patch].ravel()]]
    graph = sp.coo_array((np.ones(len(border)), (border[:, 0], border[:, 1])), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    loops, loop_of = np.unique(label[border[:, 0]], return_inverse=True)
    centres = np.stack([vertices[border[loop_of == k, 0]].mean(0) for k in range(len(loops))])
    fan = np.stack([border[:, 1], border[:, 0], count + loop_of], axis=1)
    return fan, np.concatenate([vertices, centres])


def _scene(vertices: NDArray[Any], faces: NDArray[Any]) -> Any:
    o3d = open3d()
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(vertices.astype(np.float32)), o3d.core.Tensor.from_numpy(faces.astype(np.uint32))
    )
    return scene


def _winding(vertices: NDArray[Any], faces: NDArray[Any], points: NDArray[Any], rays: NDArray[Any]) -> NDArray[Any]:
    """(N,) how often a closed surface encloses each point: the signed count of walls its ray (N, 3) crosses."""
    o3d = open3d()
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    query = o3d.core.Tensor.from_numpy(np.concatenate([points, rays], axis=1).astype(np.float32))
    hits = _scene(vertices, faces).list_intersections(query, nthreads=1)
    ray, triangle = hits["ray_ids"].numpy().astype(np.int64), hits["primitive_ids"].numpy().astype(np.int64)
    crossing = np.sign((normals[triangle] * rays[ray]).sum(1))
    return np.bincount(ray, weights=crossing, minlength=len(points))


def penetration(hand: HandModel, vertices: NDArray[Any]) -> Penetration:
    """How deep parts of a posed hand run into each other; vertices (V, 3) of the coarse mesh, metres.

    For each part, all parts that are not its neighbours are cut out of the surface and closed with caps; a vertex
    collides if these enclose it (winding number), and its depth is the distance to their skin.
    """
    depths = np.concatenate([np.zeros(1), *_depths(hand, vertices)])
    return Penetration(float(depths.max()), int((depths > TOLERANCE).sum()))


def _depths(hand: HandModel, vertices: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """How deep the vertices of one part after another are in parts that are not its neighbours."""
    o3d = open3d()
    level = min(LEVEL, hand.levels)
    fine = hand.subdivide(torch.tensor(vertices), level).numpy()
    faces = hand.topology(level).faces.astype(np.int64)
    a, b, c = (fine[faces[:, k]] for k in range(3))
    normals = np.zeros_like(fine)
    for k in range(3):
        np.add.at(normals, faces[:, k], np.cross(b - a, c - a))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lifted = fine + 1e-4 * normals  # off its own skin, so that a free vertex is outside
    inside = _winding(fine, faces, lifted, normals) > 0.5

    names, part_of_joint = np.unique(_parts(hand), return_inverse=True)
    part_of = part_of_joint[hand.weights(level).argmax(1)]
    far = np.array([[not _adjacent(part, other) for other in names] for part in names])
    across = _across(faces)
    for part in np.unique(part_of[inside]):
        patch = far[part, part_of[faces[:, 0]]]
        if not patch.any():
            continue
        own = np.flatnonzero(inside & (part_of == part))
        fan, closed = _cap(patch, across, faces, fine)
        own = own[_winding(closed, np.concatenate([faces[patch], fan]), lifted[own], normals[own]) > 0.5]
        if len(own):
            points = o3d.core.Tensor.from_numpy(lifted[own].astype(np.float32))
            yield _scene(fine, faces[patch]).compute_distance(points, nthreads=1).numpy()


def relaxed(hand: HandModel, shape: ArrayLike, pose: Pose, steps: int = 5) -> Pose:
    """The pose, or if it intersects, the strongest fraction of it (found by bisection) that does not.

    Fractions move the joints towards the rest pose, which is free of intersection; the placement stays.
    """

    def free(amount: float) -> bool:
        posed = hand.skin(shape, amount * pose.joints, dtype=torch.float64)
        return not any((depths > TOLERANCE).any() for depths in _depths(hand, posed.numpy()))  # the first decides

    if free(1.0):
        return pose
    low, high = 0.0, 1.0
    for _ in range(steps):
        middle = (low + high) / 2
        low, high = (middle, high) if free(middle) else (low, middle)
    return Pose(low * pose.joints, pose.rotation, pose.translation)
