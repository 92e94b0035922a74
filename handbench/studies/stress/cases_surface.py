"""Atlas, surface maps and relief on damaged, tiny, huge and far meshes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...errors import InputError, Unsupported
from ...render.uv.atlas import Atlas
from ...render.uv.posed import PosedSurface
from ...render.uv.surface import Relief, mesh_normals, surface_maps
from ...scene import Array, Mesh, Topology
from .case import Case
from .judgement import TruthPair, accurate, equal, finite, finite_or, refused
from .scenes import atlas, crumpled, flipped, globe, hand, moved, pointlike, tensor, torn

FAMILY = "surface"
SIZE = 48

MESHES: dict[str, Callable[[], Mesh]] = {
    "degenerate triangles": lambda: crumpled(hand()),
    "duplicate vertices": lambda: torn(hand()),
    "inverted normals": lambda: flipped(hand()),
    "all vertices in one point": lambda: pointlike(hand()),
    "self-intersection": lambda: hand("fist", 1.6),
    "scale 1e-3": lambda: moved(hand(), 1e-3),
    "scale 1e3": lambda: moved(hand(), 1e3),
    "1 km from the origin": lambda: moved(hand(), 1.0, 1000.0),
}


def cases() -> Iterator[Case]:
    for name, mesh in MESHES.items():
        yield Case(FAMILY, f"maps, {name}", finite(), partial(_maps, mesh))
        yield Case(FAMILY, f"relief, {name}", finite(), partial(_relief, mesh, 1e-3))
        yield Case(FAMILY, f"relief gradient, {name}", finite(), partial(_relief_gradient, mesh))
    for scale in (1e-3, 1e3):
        scaled = partial(_invariant, scale, 0.0)
        yield Case(FAMILY, f"relief scales, {scale:g}", equal(1e-3), scaled, "scale 1")
    for shift in (10.0, 1000.0):
        far = partial(_invariant, 1.0, shift)
        yield Case(FAMILY, f"relief {shift:g} m from the origin", equal(1e-2), far, "at the origin")
    yield Case(FAMILY, "normals of an inverted mesh", equal(1e-9), _inverted, "minus those of the mesh")
    yield Case(FAMILY, "normals of a torn mesh", equal(1e-9), _torn, "normals of its faces")
    yield Case(FAMILY, "normals of a globe", equal(0.02), _globe, "closed form")
    for depth in (0.0, 3e-3, 1.0, 1e6):
        yield Case(FAMILY, f"relief {depth:g} m deep", finite(), partial(_relief, hand, depth))
    yield Case(FAMILY, "relief without displacement", equal(1e-6), _flat, "smooth normal")
    yield Case(FAMILY, "relief float64 against float32", accurate(1e-4), _precise, "torch float64, same code")
    for dtype in (torch.float16, torch.bfloat16):
        name = str(dtype).removeprefix("torch.")
        yield Case(FAMILY, f"gather and scatter, {name}", equal(), partial(_round_trip, dtype), "the values")
        yield Case(FAMILY, f"dilate, {name}", finite(), partial(_dilate, dtype))
    for name, topology in _broken().items():
        expected = refused(Unsupported if name == "no UVs" else InputError)
        yield Case("atlas", name, expected, partial(_atlas, topology))
    for name, topology in _odd().items():
        yield Case("atlas", name, finite_or(InputError), partial(_atlas, topology))
    for size in (0, -1):
        yield Case("atlas", f"size {size}", refused(InputError), partial(_atlas, lambda: hand().topology, size))
    for size in (1, 3):
        yield Case("atlas", f"size {size}", finite_or(InputError), partial(_atlas, lambda: globe().topology, size))
    yield Case("atlas", "a texel's neighbour across a chart's border", equal(), _border, "nearest covered texel")


def _maps(mesh: Callable[[], Mesh]) -> tuple[Tensor, Tensor, Array]:
    posed = mesh()
    maps = surface_maps(posed, atlas(posed, SIZE))
    return maps.position, maps.normal, mesh_normals(posed)


def _displacement(count: int, depth: float, dtype: torch.dtype = torch.float32) -> Tensor:
    return depth * torch.sin(torch.arange(count, dtype=torch.float64))[None].to(dtype)


def _relief(mesh: Callable[[], Mesh], depth: float) -> Tensor:
    posed = PosedSurface(mesh(), SIZE)
    return posed.relief.refined(_displacement(posed.atlas.count, depth))


def _relief_gradient(mesh: Callable[[], Mesh]) -> Tensor | None:
    posed = PosedSurface(mesh(), SIZE)
    displacement = _displacement(posed.atlas.count, 1e-3).requires_grad_()
    posed.relief.refined(displacement)[0].sum().backward()
    return displacement.grad


def _invariant(scale: float, shift: float) -> TruthPair:
    """Refined normals do not change when everything is scaled or shifted."""
    there = _relief(lambda: moved(hand(), scale, shift), 1e-3 * scale)
    return TruthPair(there, _relief(hand, 1e-3), "mean")


def _flat() -> TruthPair:
    posed = PosedSurface(hand(), SIZE)
    return TruthPair(posed.relief.refined(torch.zeros(1, posed.atlas.count)), posed.normal)


def _precise() -> TruthPair:
    mesh = hand()
    where = atlas(mesh, SIZE)
    normal = torch.from_numpy(where.interpolate(mesh_normals(mesh)).T.copy())
    position = torch.from_numpy(where.interpolate(mesh.vertices).T.copy())
    relief = Relief(position, normal / normal.norm(dim=0, keepdim=True), where)
    truth = relief.refined(_displacement(where.count, 1e-3, torch.float64))
    return TruthPair(_relief(hand, 1e-3), truth, "mean")


def _inverted() -> TruthPair:
    return TruthPair(mesh_normals(flipped(hand())), -mesh_normals(hand()))


def _torn() -> TruthPair:
    mesh = torn(hand())
    corners = mesh.vertices.reshape(-1, 3, 3)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return TruthPair(mesh_normals(mesh), np.repeat(normal, 3, axis=0), least=1.0)


def _globe() -> TruthPair:
    return TruthPair(mesh_normals(globe()), globe().vertices, least=1.0)


def _round_trip(dtype: torch.dtype) -> TruthPair:
    where = atlas(hand(), SIZE)
    values = torch.randn(3, where.count, generator=torch.Generator().manual_seed(0)).to(dtype)
    return TruthPair(where.gather(where.scatter(values)), values)


def _dilate(dtype: torch.dtype) -> Tensor:
    where = atlas(hand(), SIZE)
    return where.dilate(where.scatter(torch.ones(1, where.count, dtype=dtype)), texels=2)


def _border() -> TruthPair:
    where = atlas(hand(), SIZE)
    filled = where.dilate(where.scatter(torch.ones(1, where.count)))
    return TruthPair(filled, torch.ones(1, SIZE, SIZE))


def _atlas(topology: Callable[[], Topology], size: int = SIZE) -> Any:
    where = Atlas(topology(), size)
    return where.barycentric, where.interpolate(tensor(np.ones((int(topology().faces.max()) + 1, 1))).numpy())


def _with_uvs(uvs: Array) -> Topology:
    return Topology(hand().topology.faces, uvs, hand().topology.uv_faces)


def _broken() -> dict[str, Callable[[], Topology]]:
    """Topologies of which nothing can be drawn."""
    uvs = hand().topology.unwrapped[0]
    poisoned = uvs.copy()
    poisoned[0] = np.nan
    none = np.zeros((0, 3), dtype=int)
    return {
        "all UVs in one point": lambda: _with_uvs(np.full_like(uvs, 0.5)),
        "all UVs on one line": lambda: _with_uvs(uvs * [1.0, 0.0] + [0.0, 0.31]),
        "all UVs outside the texture": lambda: _with_uvs(uvs + 5.0),
        "UVs that reach outside": lambda: _with_uvs(uvs * 1.5 - 0.25),
        "NaN in UVs": lambda: _with_uvs(poisoned),
        "empty UVs": lambda: _with_uvs(np.zeros((0, 2))),
        "no UVs": lambda: Topology(hand().topology.faces),
        "no faces": lambda: Topology(none, uvs, none),
        "faces beyond the UVs": lambda: Topology(np.array([[0, 1, 2]]), uvs[:2], np.array([[0, 1, 2]])),
        "negative faces": lambda: Topology(np.array([[0, 1, 2]]), uvs, np.array([[0, 1, -2]])),
    }


def _odd() -> dict[str, Callable[[], Topology]]:
    """Topologies that can be drawn in part."""
    uvs, uv_faces = hand().topology.unwrapped
    collapsed = uvs.copy()
    collapsed[uv_faces[::5].ravel()] = 0.5
    return {
        "a fifth of the UV triangles without area": lambda: _with_uvs(collapsed),
        "mirrored UVs": lambda: _with_uvs(1.0 - uvs),
        "all charts on top of each other": lambda: _with_uvs(uvs % 0.5),
    }
