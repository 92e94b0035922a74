"""Cameras in odd places, tiny pictures, textures of low precision."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...errors import InputError
from ...render.see.raster import Raster, rasterise
from ...scene import Camera, Mesh
from .case import Case
from .cases_surface import MESHES
from .judgement import TruthPair, accurate, equal, finite, finite_or, refused
from .scenes import camera, globe, hand, moved

FAMILY = "raster"
SIZE = 32


def cases() -> Iterator[Case]:
    for name, mesh in MESHES.items():
        yield Case(FAMILY, name, finite(), partial(_everything, mesh, partial(_facing_of, mesh)))
    for name, view in _views().items():
        yield Case(FAMILY, name, finite(), partial(_everything, globe, view))
        yield Case(FAMILY, f"gradient, {name}", finite(), partial(_gradient, view))
    for name, view in _empty().items():
        yield Case(FAMILY, f"{name} is empty", equal(), partial(_alpha_is_zero, view), "zero")
    yield Case(FAMILY, "camera inside sees everything", equal(), _inside, "one")
    for scale, shift in ((1e-3, 0.0), (1e3, 0.0), (1.0, 100.0), (1.0, 1e4)):
        name = f"the same picture at scale {scale:g}" if scale != 1 else f"the same picture {shift:g} m from the origin"
        yield Case(FAMILY, name, equal(1e-2), partial(_same_picture, scale, shift), "scale 1 at the origin")
    yield Case(FAMILY, "a constant texture", equal(1e-6), _constant, "coverage times the constant")
    yield Case(FAMILY, "a texture of 1e8 beside 1e-8", accurate(1e-6), _contrast, "torch float64, same code")
    for dtype in (torch.float16, torch.bfloat16):
        name = str(dtype).removeprefix("torch.")
        yield Case(FAMILY, f"{name} texture", finite_or(InputError), partial(_low_precision, dtype))
    yield Case(FAMILY, "texture that is not square", refused(InputError), lambda: _drawn(torch.zeros(3, 8, 9)))
    yield Case(FAMILY, "texture without texels", refused(InputError), lambda: _drawn(torch.zeros(3, 0, 0)))
    yield Case(FAMILY, "texture of one texel", finite(), lambda: _drawn(torch.ones(3, 1, 1)))
    yield Case(FAMILY, "supersample 0", refused(InputError), lambda: rasterise(globe(), _outside(), 0))
    for name, make in _broken().items():
        yield Case(FAMILY, name, refused(InputError), partial(_everything, globe, make))


def _outside() -> Camera:
    return camera(np.array([0.0, 0.5, 5.0]), np.zeros(3), SIZE)


def _facing(mesh: Mesh) -> Camera:
    """A camera that has the whole mesh in view."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    away = 3.0 * max(float(np.linalg.norm(high - low)), 1e-3)
    return camera((low + high) / 2 + [0.0, 0.1 * away, away], (low + high) / 2, SIZE)


def _facing_of(mesh: Callable[[], Mesh]) -> Camera:
    return _facing(mesh())


def _views() -> dict[str, Callable[[], Camera]]:
    corner = globe().vertices[40]
    return {
        "camera inside the mesh": lambda: camera(np.array([0.1, 0.0, 0.2]), np.array([0.0, 0.0, 1.0]), SIZE),
        "camera exactly on a vertex": lambda: camera(corner, np.zeros(3), SIZE),
        "camera in the plane of the mesh's side": lambda: camera(
            np.array([1.0, 0.0, 0.0]), np.array([1.0, 0, 1]), SIZE
        ),
        "camera 1 mm off": lambda: camera(1.001 * corner, np.zeros(3), SIZE),
        "camera 1e5 m off": lambda: camera(np.array([0, 0, 1e5]), np.zeros(3), SIZE, focal=5e4),
        "picture of one pixel": lambda: camera(np.array([0.0, 0.5, 5.0]), np.zeros(3), 1),
        "field of view of 179 degrees": lambda: camera(np.array([0.0, 0.5, 5.0]), np.zeros(3), SIZE, focal=0.0087),
    }


def _empty() -> dict[str, Callable[[], Camera]]:
    return {
        "mesh behind the camera": lambda: camera(np.array([0.0, 0.5, 5.0]), np.array([0.0, 0.5, 9.0]), SIZE),
        "mesh beside the picture": lambda: camera(np.array([0.0, 0.5, 5.0]), np.array([50.0, 0.5, 0.0]), SIZE),
        "mesh smaller than a subsample": lambda: camera(np.array([1.0, 0.4, 1e7]), np.array([3e6, 0.0, 0.0]), SIZE),
    }


def _broken() -> dict[str, Callable[[], Camera]]:
    outside = _outside()

    def with_k(scale: float) -> Camera:
        return replace(outside, K=outside.K * np.array([[scale], [scale], [1.0]]))

    return {
        "camera without focal length": lambda: with_k(0.0),
        "camera with NaN": lambda: with_k(float("nan")),
        "camera of no size": lambda: replace(outside, width=0),
        "camera that mirrors": lambda: replace(outside, world_to_camera=outside.world_to_camera * [[-1.0], [1], [1]]),
        "camera that scales": lambda: replace(outside, world_to_camera=outside.world_to_camera * 2.0),
    }


def _everything(mesh: Callable[[], Mesh], view: Callable[[], Camera]) -> Any:
    """All that a raster gives: coverage, UVs, normals, an attribute and a texture's picture."""
    drawn = rasterise(mesh(), view())
    texture = torch.rand(3, 16, 16, generator=torch.Generator().manual_seed(0))
    return (drawn.alpha, drawn.uv, drawn.normal, drawn.depth, drawn.attribute(mesh().vertices), drawn.sample(texture))


def _drawn(texture: Tensor) -> Tensor:
    return rasterise(globe(), _outside()).sample(texture)


def _gradient(view: Callable[[], Camera]) -> Tensor | None:
    texture = torch.rand(3, 16, 16, generator=torch.Generator().manual_seed(0)).requires_grad_()
    rasterise(globe(), view()).sample(texture).square().sum().backward()
    return texture.grad


def _alpha_is_zero(view: Callable[[], Camera]) -> TruthPair:
    drawn = rasterise(globe(), view())
    return TruthPair(
        (drawn.alpha, drawn.sample(torch.ones(1, 8, 8))), (np.zeros((SIZE, SIZE)), np.zeros((1, SIZE, SIZE)))
    )


def _inside() -> TruthPair:
    drawn = rasterise(globe(), _views()["camera inside the mesh"]())
    return TruthPair(drawn.alpha, np.ones((SIZE, SIZE)))


def _picture(mesh: Mesh, eye: Camera) -> tuple[Raster, Tensor]:
    drawn = rasterise(mesh, eye)
    texture = torch.rand(3, 16, 16, generator=torch.Generator().manual_seed(0))
    return drawn, drawn.sample(texture)


def _same_picture(scale: float, shift: float) -> TruthPair:
    """The mesh and its camera scaled and shifted together."""
    target = hand().vertices.mean(axis=0)
    eye = target + np.array([0.0, 0.1, 0.6])
    near = camera(eye, target, SIZE)
    far = camera(eye * scale + shift, target * scale + shift, SIZE)
    _, there = _picture(moved(hand(), scale, shift), far)
    _, here = _picture(hand(), near)
    return TruthPair(there, here, "mean")


def _constant() -> TruthPair:
    drawn = rasterise(globe(), _outside())
    return TruthPair(drawn.sample(torch.full((1, 16, 16), 0.7)), 0.7 * drawn.alpha[None])


def _contrast() -> TruthPair:
    texture = torch.full((1, 16, 16), 1e-8, dtype=torch.float64)
    texture[:, ::2] = 1e8
    drawn = rasterise(globe(), _outside())
    return TruthPair(drawn.sample(texture.float()), drawn.sample(texture))


def _low_precision(dtype: torch.dtype) -> Tensor:
    return _drawn(torch.rand(3, 16, 16, generator=torch.Generator().manual_seed(0)).to(dtype))
