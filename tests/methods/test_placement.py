"""Where tensors are: what a method works with is all on its networks' device, tried on torch's `meta` device.

It computes shapes and no values, and refuses to mix its tensors with the CPU's.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from handbench.hand.openhand import OpenHand, named_pose
from handbench.light.lightset import LightSet
from handbench.methods.geometry.config import configuration as geometry_preset
from handbench.methods.geometry.model import GeometryModel
from handbench.methods.geometry.scan import PointCloud
from handbench.methods.relightablehands.config import PRESETS as RELIGHTABLE
from handbench.methods.relightablehands.model import RelightableHandsModel, ViewedTexels, lit
from handbench.methods.urhand import lighting
from handbench.methods.urhand.config import configuration
from handbench.methods.urhand.model import URHandModel
from handbench.render.see.raster import rasterise
from handbench.render.shade import shading
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Camera, Mesh
from handbench.skips import NONE, skipping

META = torch.device("meta")
LIGHTS = LightSet(np.eye(3), np.array([[1.0, 0.5, 0.2]] * 3), np.array([[0.0, 0.1, 0.5]]), np.ones((1, 3)))


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    hand = OpenHand.load()
    return hand.mesh(hand.neutral(), named_pose("fist"), 1)


class _OneDevice(TorchDispatchMode):
    """Fails where an operation mixes tensors of more than one element from different devices."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        flat = torch.utils._pytree.tree_leaves((args, kwargs or {}))
        places = {each.device.type for each in flat if isinstance(each, torch.Tensor) and each.dim()}
        assert len(places) <= 1 or "copy" in func.name() or "index" in func.name(), func.name()
        return func(*args, **(kwargs or {}))


@contextmanager
def all_on_meta() -> Iterator[None]:
    """With what would look at values left out: skips by light, checks for NaN, whether light is white."""
    with pytest.MonkeyPatch.context() as patch, torch.no_grad(), skipping(NONE), _OneDevice():
        patch.setattr(shading, "_checked", lambda **maps: tuple(maps.values()))
        patch.setattr(torch, "equal", lambda *_: False)
        yield


@pytest.mark.parametrize("preset", ["smoke", "released"])
def test_urhand_stays_on_its_device(mesh: Mesh, preset: str) -> None:
    config = replace(configuration(preset), texture=64)
    model = URHandModel(config, 20).eval().to(META)
    lights = LIGHTS if config.near_lights else LightSet(*(np.asarray(v) for v in _distant()))
    with all_on_meta():
        surface = PosedSurface(mesh, 64, META)
        texture = torch.rand(3, 64, 64, device=META)
        material = model.material(texture, torch.zeros(20, 3, device=META), surface)
        visible = torch.ones(len(lights), surface.atlas.count, device=META)
        maps = (material.normal, material.roughness, surface.position, np.ones(3))
        features = lighting.features(config, *maps, lights, visible)
        colour, _ = model.colour(features, lights, material, texture, surface.atlas)
        drawn = surface.atlas.dilate(surface.atlas.scatter(colour))
    assert drawn.device == META and drawn.shape == (3, 64, 64)


def _distant() -> tuple[np.ndarray, ...]:
    nothing = np.zeros((0, 3))
    return LIGHTS.directions, LIGHTS.irradiance, nothing, nothing


def test_relightablehands_stays_on_its_device(mesh: Mesh) -> None:
    config = RELIGHTABLE["smoke"]
    model = RelightableHandsModel(config, 20, 0.3).eval().to(META)
    with all_on_meta():
        surface = PosedSurface(mesh, config.texture, META)
        seen = ViewedTexels.of(surface, np.ones(3), np.zeros((20, 3)))
        visible = torch.ones(4, surface.atlas.count, device=META)
        responses, _ = model.responses(seen, LIGHTS.directions, visible, LIGHTS.positions)
        assert lit(responses, np.ones((4, 3))).device == META


def test_the_product_of_another_device_is_the_cpus(mesh: Mesh) -> None:
    """Other devices look textures up by torch's sparse product; here it is asked of the CPU."""
    camera = Camera(
        "front", 48, 64, [[200, 0, 24], [0, 200, 32], [0, 0, 1]], np.c_[np.diag([1.0, -1, -1]), [0, 0, 0.6]]
    )
    raster = rasterise(mesh, camera)
    texture = torch.rand(5, 32, 32, requires_grad=True)
    expected = raster.sample(texture)
    found = raster._lookup(32).image(texture.flatten(1)).unflatten(1, (64, 48))
    assert expected.abs().max() > 0.5 and (expected - found).abs().max() < 1e-6
    wanted, gradient = (torch.autograd.grad(image.square().sum(), texture)[0] for image in (expected, found))
    assert (wanted - gradient).abs().max() < 1e-5 * wanted.abs().max()


def test_the_geometry_autoencoder_stays_on_its_device() -> None:
    """Scans, pictures and poses come from the CPU and tracked meshes go there; nothing between does."""
    hand, size = OpenHand.load(), geometry_preset("smoke")
    model = GeometryModel(size, hand, 1).eval().to(META)
    told = named_pose("fist")
    camera = Camera("front", 48, 64, [[200, 0, 24], [0, 200, 32], [0, 0, 1]], np.eye(3, 4))

    def product(matrix: torch.Tensor, values: torch.Tensor) -> torch.Tensor:  # torch has none for meta
        assert matrix.device == values.device
        return values.new_empty(matrix.shape[0], values.shape[1])

    with all_on_meta(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(torch.sparse, "mm", product)
        points = np.asarray(hand.points)
        mean, _ = model.encode(PointCloud(np.zeros((4, 3)), np.eye(4, 3), np.ones(4)), points)
        shape = model.shape(mean)
        beyond = model.beyond(torch.zeros(3, size.image, size.image), camera, points, told)
        posed = model.posed(shape, told, beyond)
    assert {each.device for each in (mean, shape.vertices, beyond, posed.vertices, posed.correctives)} == {META}
    assert posed.vertices.shape == hand.rest_position(1).shape
