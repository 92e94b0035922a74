"""The UV atlas of the open hand: MakeHuman's charts, unfolded until they fill the unit square evenly.

MakeHuman's hand is one island (the back, joined to the palm along the little finger). It is pulled into a comb: the
fingers become parallel lanes, back on the left and palm on the right, while the symmetric Dirichlet energy (Smith and
Schaefer, 2015) keeps every triangle unflipped and its area and angles near the skin's. The forearm becomes a strip
below the palm, the cap a small disc in a corner. Neighbouring charts and lanes stay GUTTER apart.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sp
import torch
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from torch import Tensor

Array = NDArray[Any]
GUTTER = 2.6 / 128  # a little more than the two texels asked for: the walls of the lanes are soft
HAND_AREA = 0.73  # of the square, if nothing were squeezed
FINGERS = ("index", "middle", "ring", "little")  # of the back from left to right; those of the palm mirrored
LANES = (
    0.03 + 0.94 * np.array([0.0, 1.05, 2.1, 3.1, 4.8, 5.8, 6.85, 7.9]) / 7.9
)  # borders of the lanes of the seven strips
THUMBS = (0.135, 0.865)  # the thumbs lie left and right of these, below the fingers
KNUCKLES = 0.6
TONGUE = (0.52, 0.1)  # source u and v beyond which the island of the hand is its tongue
FOREARM_BOX = (0.25, 0.0, 1.0, 0.18)
CAP_BOX = (0.97, 0.2, 0.99, 0.22)


def make_atlas(
    vertices: Array, quads: Array, uv_faces: Array, uvs: Array, weights: Array, joints: list[str]
) -> tuple[Array, Array]:
    """UVs (T, 2) and quads into them; `uv_faces` indexes the source `uvs` for all quads but the cap's last ones."""
    body = quads[: len(uv_faces)]
    chart = (uvs[uv_faces][:, :, 1].mean(1) > 0.5).astype(int)  # 0 hand, 1 forearm
    keys, uv_quads = np.unique(chart[:, None] * len(uvs) + uv_faces, return_inverse=True)
    uv_quads = uv_quads.reshape(uv_faces.shape)
    start = uvs[keys % len(uvs)]
    chart_of = keys // len(uvs)
    vertex_of = np.zeros(len(keys), dtype=int)
    vertex_of[uv_quads] = body
    side = np.zeros(len(keys))
    corners = vertices[body]
    normals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    np.add.at(side, uv_quads, normals[:, 2:3] / np.linalg.norm(normals, axis=1, keepdims=True))
    tri = np.concatenate(
        [uv_quads[:, [0, 1, 2]], uv_quads[:, [0, 2, 3]], uv_quads[:, [0, 1, 3]], uv_quads[:, [1, 2, 3]]]
    )
    placed = unfold(vertices[vertex_of], tri, start, chart_of, weights[vertex_of], side, joints)

    cap = quads[len(uv_faces) :]
    ids, cap_quads = np.unique(cap, return_inverse=True)
    disc = vertices[ids][:, [0, 2]]
    disc = (disc - disc.min(0)) / np.ptp(disc, axis=0)
    low, high = np.array(CAP_BOX[:2]), np.array(CAP_BOX[2:])
    cap_uvs = low + disc * (high - low)
    return np.concatenate([placed, cap_uvs]), np.concatenate([uv_quads, cap_quads.reshape(-1, 4) + len(placed)])


def unfold(
    points: Array, tri: Array, start: Array, chart: Array, weights: Array, side: Array, joints: list[str]
) -> Array:
    """Positions (T, 2) in the unit square of UV vertices with skin positions `points` (T, 3)."""
    edge1, edge2 = points[tri[:, 1]] - points[tri[:, 0]], points[tri[:, 2]] - points[tri[:, 0]]
    length = np.linalg.norm(edge1, axis=1)
    x2 = (edge1 * edge2).sum(1) / length
    y2 = np.sqrt(np.maximum((edge2**2).sum(1) - x2**2, 1e-12))
    area = 0.5 * length * y2
    scale = np.sqrt(HAND_AREA / (0.5 * area[chart[tri[:, 0]] == 0].sum()))  # four triangles cover a quad twice
    flat = np.zeros((len(tri), 2, 2))
    flat[:, 0, 0], flat[:, 0, 1], flat[:, 1, 1] = length * scale, x2 * scale, y2 * scale
    inverse = torch.tensor(np.linalg.inv(flat))
    share = torch.tensor(area / area.sum())

    position = start.copy()
    uv_area = _signed(position, tri)
    if np.median(uv_area) < 0:
        position[:, 0] *= -1
    walls, goal, pulled = _walls(points, chart, weights, side, joints, tri, start)
    for c in range(2):  # rest the source charts at skin scale on their goals, turned to fit best (Procrustes)
        own = chart == c
        known = own & (pulled > 0)
        p, g = position - position[known].mean(0), goal[known].mean(0)
        u, _, vt = np.linalg.svd(p[known].T @ (goal[known] - g))
        turn = u @ np.diag([1, np.sign(np.linalg.det(u @ vt))]) @ vt
        own_tri = chart[tri[:, 0]] == c
        size = np.sqrt(area[own_tri].sum() * scale**2 / np.abs(_signed(position, tri)[own_tri]).sum())
        position[own] = p[own] @ turn * size + g

    low, high = (torch.tensor(w) for w in walls)
    corner = torch.tensor(tri)
    aim, heed = torch.tensor(goal), torch.tensor(pulled)[:, None]

    def energy(x: Tensor, wall: float, pull: float) -> Tensor:
        a = x[corner[:, 0]]
        frame = torch.stack([x[corner[:, 1]] - a, x[corner[:, 2]] - a], -1)
        jacobian = frame @ inverse
        det = torch.linalg.det(jacobian)
        if (det <= 0).any():
            return torch.tensor(torch.inf, dtype=x.dtype)
        square = (jacobian**2).sum((-1, -2))
        dirichlet = (share * (square + square / det**2)).sum()
        outside = torch.relu(low - x) ** 2 + torch.relu(x - high) ** 2
        return dirichlet + wall * outside.mean() + pull * (heed * (x - aim) ** 2).mean()

    laplacian = _laplacian(tri, area, len(points))
    solve = splu(sp.csc_matrix(laplacian + 1e-3 * sp.eye_array(len(points)))).solve
    for wall, pull, steps in (
        (0, 100, 150),
        (0, 10, 100),
        (100, 10, 150),
        (1e3, 1, 200),
        (1e4, 0, 300),
        (1e5, 0, 300),
        (1e6, 0, 300),
    ):
        position = _descend(lambda x, w=wall, p=pull: energy(x, w, p), position, solve, steps)
        out = np.maximum(np.maximum(walls[0] - position, position - walls[1]), 0)
        print(f"  atlas: walls {wall:g}: energy {float(energy(torch.tensor(position), 0, 0)):.3f}, out {out.max():.4f}")
    return position


def _strips(points: Array, hand: Array, share: Array, side: Array, tri: Array) -> list[tuple[Array, bool]]:
    """A finger's pieces in the hand chart: (UV vertices as a mask, whether it is on the palm)."""
    inside = hand & (share > 0.9)
    pairs = tri[inside[tri].all(1)][:, [0, 1, 1, 2]].reshape(-1, 2)
    graph = sp.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
    _, label = connected_components(graph, directed=False)
    sizes = np.bincount(label[inside], minlength=label.max() + 1)
    return [(inside & (label == piece), side[label == piece].mean() > 0) for piece in np.flatnonzero(sizes > 20)]


def _walls(
    points: Array, chart: Array, weights: Array, side: Array, joints: list[str], tri: Array, start: Array
) -> tuple[tuple[Array, Array], Array, Array]:
    """Box ((T, 2) low, high) of every UV vertex, the place (T, 2) fingers start out for, and who heeds it (T,)."""
    half = GUTTER / 2
    low, high = np.full((len(points), 2), half), np.full((len(points), 2), 1 - half)
    hand = chart == 0
    low[hand, 1] = FOREARM_BOX[3] + half
    fingers = weights[:, [i for i, name in enumerate(joints) if name[-1] in "123"]].sum(1)
    beside_thumb = hand & (points[:, 1] > 0.062) & (fingers < 0.6)  # the fingers themselves are set below
    low[beside_thumb, 0], high[beside_thumb, 0] = THUMBS[0] + half, THUMBS[1] - half
    goal, pulled = np.zeros((len(points), 2)), np.zeros(len(points))
    # The thumb side of the wrist hangs on the back as a tongue; it hangs down, left of the forearm.
    tongue = hand & (start > TONGUE).all(1)
    low[tongue, 1] = half
    high[tongue, 0] = FOREARM_BOX[0] - half
    goal[tongue] = [0.08, 0.08]
    pulled[tongue] = 1
    for finger in ("thumb", *FINGERS):
        columns = [joints.index(f"{finger}{k}") for k in (1, 2, 3)]
        share = weights[:, columns].sum(1)
        for strip, palm in _strips(points, hand, share, side, tri):
            base = points[strip & (weights[:, columns[0]] > 0.5)].mean(0)[:2]
            tip = points[strip & (weights[:, columns[2]] > 0.5)].mean(0)[:2]
            axis = (tip - base) / np.linalg.norm(tip - base)
            if finger == "thumb":
                left, right = (THUMBS[1], 1.0) if palm else (0.0, THUMBS[0])
                own = strip & (weights[:, columns[1:]].sum(1) > 0.6)
                high[strip, 1] = KNUCKLES - half
                low[strip, 0], high[strip, 0] = half, 1 - half
            else:
                lane = 6 - FINGERS.index(finger) if palm else FINGERS.index(finger)
                left, right = LANES[lane], LANES[lane + 1]
                own = strip
                if finger == "index":
                    low[hand & (share > 0.25), 1] = KNUCKLES + half
            low[own, 0], high[own, 0] = left + half, right - half
            goal[strip, 0] = (left + right) / 2
            goal[strip, 1] = (base[1] + (points[strip, :2] - base) @ axis + 0.02) / 0.205
            pulled[strip] = 1
    arm = chart == 1
    low[arm] = FOREARM_BOX[0] + half, FOREARM_BOX[1] + half
    high[arm] = FOREARM_BOX[2] - half, FOREARM_BOX[3] - half
    goal[arm] = (low[arm] + high[arm]) / 2
    goal[arm, 1] += 2 * (points[arm, 1] - points[arm, 1].mean())
    pulled[arm] = 1
    return (low, high), goal, pulled


def _signed(position: Array, tri: Array) -> Array:
    a, b = position[tri[:, 1]] - position[tri[:, 0]], position[tri[:, 2]] - position[tri[:, 0]]
    return 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _laplacian(tri: Array, area: Array, count: int) -> sp.csr_array:
    """Graph Laplacian weighted by area: a stand-in for the energy's Hessian that spreads each step smoothly."""
    pairs = np.concatenate([tri[:, [0, 1]], tri[:, [1, 2]], tri[:, [2, 0]]])
    value = np.ones(len(pairs)) / len(pairs)
    graph = sp.coo_array((value, (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    graph = graph + graph.T
    return sp.csr_array(sp.diags_array(graph.sum(axis=1)) - graph) * count / 4


def _descend(energy: Callable[[Tensor], Tensor], start: Array, solve: Callable[[Array], Array], steps: int) -> Array:
    """L-BFGS (memory 8) preconditioned by `solve`, with a backtracking search that never accepts a flip."""

    def evaluate(x: Array) -> tuple[float, Array]:
        tensor = torch.tensor(x, requires_grad=True)
        value = energy(tensor)
        if not torch.isfinite(value):
            return np.inf, x
        value.backward()
        return value.item(), tensor.grad.numpy()

    x = start
    value, gradient = evaluate(x)
    assert np.isfinite(value), "the start has flipped triangles"
    history: list[tuple[Array, Array, float]] = []
    for _ in range(steps):
        q = gradient.copy()
        factors = []
        for s, y, rho in reversed(history):
            factors.append(rho * (s * q).sum())
            q -= factors[-1] * y
        q = solve(q)
        for (s, y, rho), factor in zip(history, reversed(factors), strict=True):
            q += s * (factor - rho * (y * q).sum())
        slope = (q * gradient).sum()
        step = 1.0
        while step > 1e-9:
            trial = x - step * q
            new_value, new_gradient = evaluate(trial)
            if new_value <= value - 1e-4 * step * slope:
                break
            step *= 0.5
        else:
            if not history:
                break
            history = []
            continue
        s, y = trial - x, new_gradient - gradient
        if (s * y).sum() > 1e-14:
            history = [*history[-7:], (s, y, 1 / (s * y).sum())]
        x, value, gradient = trial, new_value, new_gradient
    return x
