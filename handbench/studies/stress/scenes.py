"""What the cases are made of: directions in odd places, small meshes, cameras, the shipped capture."""

from __future__ import annotations

from functools import cache

import numpy as np
import torch
from torch import Tensor

from ...hand import hand_model
from ...light.lightset import LightSet
from ...render.uv.atlas import Atlas
from ...scene import Array, Camera, Mesh, Pose, Topology

NONE = np.zeros((0, 3))
WHITE = np.ones(3)


def unit(vectors: Array) -> Array:
    """Vectors (..., 3) made unit, in float64."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def exact(vectors: Array) -> Array:
    """Vectors that float32 holds, as float64: a float32 function is given these, and its reference the same ones.

    Unit vectors are then unit to float32 only; where that matters the reference makes them so with `unit`.
    """
    return vectors.astype(np.float32).astype(np.float64)


def sphere_directions(count: int, seed: int = 0) -> Array:
    """Random unit directions (count, 3)."""
    return unit(np.random.default_rng(seed).standard_normal((count, 3)))


def around(normal: Array, seed: int, least: float = 0.05) -> Array:
    """For each normal (N, 3) a direction above its horizon by a sine of at least `least`."""
    other = sphere_directions(len(normal), seed)
    height = (other * normal).sum(1, keepdims=True)
    wanted = np.maximum(np.abs(height), least)
    along = unit(other - height * normal)
    return wanted * normal + np.sqrt(np.maximum(1.0 - wanted**2, 0.0)) * along


def tangent(normal: Array) -> Array:
    """For each normal (N, 3) a unit direction at right angles to it."""
    helper = np.where(np.abs(normal[:, :1]) < 0.6, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    return unit(np.cross(normal, helper))


def tensor(values: Array, dtype: torch.dtype = torch.float32) -> Tensor:
    return torch.tensor(np.asarray(values), dtype=dtype)


def distant(directions: Array, irradiance: Array | Tensor) -> LightSet:
    return LightSet(directions, irradiance, NONE, NONE)  # type: ignore[arg-type]


def near(positions: Array, intensities: Array) -> LightSet:
    return LightSet(NONE, NONE, positions, intensities)


def camera(eye: Array, target: Array, size: int = 48, focal: float = 1.5) -> Camera:
    """A square camera at `eye` that looks at `target`, with a focal length of `focal` image widths."""
    forward = unit(np.asarray(target, dtype=np.float64) - eye)
    helper = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    right = unit(np.cross(forward, helper))
    rotation = np.stack([right, np.cross(forward, right), forward])
    intrinsics = np.array([[focal * size, 0, size / 2], [0, focal * size, size / 2], [0, 0, 1.0]])
    return Camera("stress", size, size, intrinsics, np.column_stack([rotation, -rotation @ eye]))


@cache
def globe(rows: int = 16, columns: int = 32) -> Mesh:
    """A closed unit sphere, unwrapped by longitude and latitude."""
    theta, phi = np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, columns + 1)
    inner = [[np.sin(t) * np.sin(p), np.cos(t), np.sin(t) * np.cos(p)] for t in theta[1:-1] for p in phi[:-1]]
    vertices = np.array([[0.0, 1, 0], *inner, [0, -1, 0]])
    uvs = np.array([[p / (2 * np.pi), 1 - t / np.pi] for t in theta for p in phi])

    def vertex(i: int, j: int) -> int:
        return 0 if i == 0 else len(vertices) - 1 if i == rows else 1 + (i - 1) * columns + j % columns

    faces, uv_faces = [], []
    for i in range(rows):
        for j in range(columns):
            corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
            for triangle in ([0, 1, 2], [0, 2, 3]):
                picked = [corners[k] for k in triangle]
                if len({vertex(*corner) for corner in picked}) == 3:
                    faces.append([vertex(*corner) for corner in picked])
                    uv_faces.append([a * (columns + 1) + b for a, b in picked])
    return Mesh(vertices, Topology(np.array(faces), uvs, np.array(uv_faces)))


@cache
def hand(pose: str = "open", bend: float = 1.0) -> Mesh:
    """The neutral shipped hand, its named pose bent by a factor."""
    model = hand_model()
    return model.mesh(model.neutral(), Pose(bend * model.named_pose(pose).joints), level=1)


@cache
def plates(gap: float = 0.004) -> Mesh:
    """Two parallel squares of 10 cm, the upper one `gap` metres above the middle of the lower; both face up."""
    square = np.array([[-1.0, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]]) * 0.05
    vertices = np.concatenate([square, square * 0.5 + [0, gap, 0]])
    uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    uvs = np.concatenate([uvs * [0.45, 1], uvs * [0.45, 1] + [0.55, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    return Mesh(vertices, Topology(faces, uvs, faces))


def moved(mesh: Mesh, scale: float = 1.0, shift: float = 0.0) -> Mesh:
    """The mesh scaled about the origin, then shifted by the same distance along all axes."""
    return Mesh(mesh.vertices * scale + shift, mesh.topology)


def flipped(mesh: Mesh) -> Mesh:
    """The mesh with its faces turned inside out."""
    uvs, uv_faces = mesh.topology.unwrapped
    return Mesh(mesh.vertices, Topology(mesh.topology.faces[:, ::-1], uvs, uv_faces[:, ::-1]))


def torn(mesh: Mesh) -> Mesh:
    """The mesh with every vertex repeated for each of its faces."""
    topology = mesh.topology
    own = np.arange(topology.faces.size).reshape(-1, 3)
    return Mesh(mesh.vertices[topology.faces.ravel()], Topology(own, topology.uvs, topology.uv_faces))


def crumpled(mesh: Mesh, every: int = 7) -> Mesh:
    """The mesh with every few faces collapsed: two corners on one point, or all three in a line."""
    vertices = mesh.vertices.copy()
    a, b, c = mesh.topology.faces[::every].T
    half = len(a) // 2
    vertices[b[:half]] = vertices[a[:half]]
    vertices[c[half:]] = 0.5 * (vertices[a[half:]] + vertices[b[half:]])
    return Mesh(vertices, mesh.topology)


def pointlike(mesh: Mesh) -> Mesh:
    """The mesh with all vertices in one point."""
    return Mesh(np.zeros_like(mesh.vertices), mesh.topology)


@cache
def atlas(mesh: Mesh, size: int = 48) -> Atlas:
    return Atlas.of(mesh.topology, size)
