"""Analytic meshes with UVs and simple cameras."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from handbench.scene import Camera, Mesh, Topology


def grid_mesh(surface, rows: int, columns: int, box=(0.02, 0.02, 0.98, 0.98)) -> Mesh:
    """A grid of quads cut in two: surface(s, t) -> (x, y, z) for s, t in [0, 1]; UVs fill `box`.

    Faces wind so that the outside is where surface_s x surface_t points.
    """
    t, s = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    index = np.arange(t.size).reshape(t.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(corner, -1).reshape(-1, 3) for corner in ((a, b, c), (a, c, d))])
    vertices = np.stack(np.broadcast_arrays(*surface(s, t)), -1).reshape(-1, 3)
    u0, v0, u1, v1 = box
    uvs = np.stack([u0 + (u1 - u0) * s, v0 + (v1 - v0) * t], -1).reshape(-1, 2)
    return Mesh(vertices, Topology(faces, uvs, faces))


def weld(mesh: Mesh) -> Mesh:
    """Vertices at one place become one (UVs stay apart), and faces without area go."""
    rounded = np.round(mesh.vertices, 9)
    _, first, inverse = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[mesh.topology.faces]
    proper = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    topology = Topology(faces[proper], mesh.topology.uvs, mesh.topology.uv_faces[proper])
    return Mesh(mesh.vertices[first], topology)


def sphere(
    rows: int = 48, columns: int = 96, radius: float = 1.0, centre=(0.0, 0.0, 0.0), box=(0.02, 0.02, 0.98, 0.98)
):
    def surface(s, t):
        phi, theta = 2 * np.pi * s, np.pi * (1 - t)
        x = radius * np.sin(theta) * np.sin(phi)
        return x + centre[0], radius * np.cos(theta) + centre[1], radius * np.sin(theta) * np.cos(phi) + centre[2]

    return weld(grid_mesh(surface, rows, columns, box))


def plane(size: float = 1.0, cells: int = 8, height: float = 0.0, box=(0.02, 0.02, 0.98, 0.98)):
    """A square in the xz plane, facing +y."""
    return grid_mesh(lambda s, t: (size * (s - 0.5), height + 0 * s, size * (0.5 - t)), cells, cells, box)


def torus(rows: int = 48, columns: int = 96, ring: float = 1.0, tube: float = 0.4):
    def surface(s, t):
        a, b = 2 * np.pi * s, 2 * np.pi * t
        across = ring + tube * np.cos(b)
        return across * np.sin(a), tube * np.sin(b), across * np.cos(a)

    return weld(grid_mesh(surface, rows, columns))


def join(*meshes: Mesh) -> Mesh:
    """Several meshes as one; their UVs must not overlap."""
    vertices, faces, uvs, uv_faces = [], [], [], []
    for mesh in meshes:
        faces.append(mesh.topology.faces + sum(map(len, vertices)))
        uv_faces.append(mesh.topology.uv_faces + sum(map(len, uvs)))
        vertices.append(mesh.vertices)
        uvs.append(mesh.topology.uvs)
    return Mesh(np.concatenate(vertices), Topology(*map(np.concatenate, (faces, uvs, uv_faces))))


def camera(width=96, height=80, focal=160.0, eye=(0.0, 0.0, 5.0), target=(0.0, 0.0, 0.0)) -> Camera:
    """A camera at `eye` that looks at `target`, +y up in its picture."""
    eye, forward = np.array(eye), np.array(target) - np.array(eye)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera("test", width, height, K, np.concatenate([rotation, (-rotation @ eye)[:, None]], axis=1))


@pytest.fixture(autouse=True)
def blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fused kernels work in blocks of 64 texels: a kernel takes a second to compile, so tests share one size."""
    from handbench.render.shade import fused

    monkeypatch.setattr(fused, "_BLOCK", 64)


@pytest.fixture
def fuse(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Once called, the fused kernel shades whatever there is."""
    from handbench.render.shade import switch

    return lambda: monkeypatch.setattr(switch, "_FUSE", 0)


@pytest.fixture(scope="session")
def shapes() -> SimpleNamespace:
    return SimpleNamespace(sphere=sphere, plane=plane, torus=torus, join=join, camera=camera)
