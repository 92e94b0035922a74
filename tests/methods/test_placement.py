"""Where tensors are: what a method works with is all on its networks' device, tried on torch's `meta` device.

It computes shapes and no values, refuses to mix its tensors with the CPU's, and has nothing that could be copied there.
So what runs here waits for no device: no `.cpu()`, no `.item()`, no `if` about a value.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

import handbench.methods
from handbench.bench.resolving import Selected, resolve
from handbench.bench.run import find_protocol
from handbench.data.openstage import open_capture
from handbench.hand.openhand import OpenHand, named_pose
from handbench.light.lightset import LightSet
from handbench.method import Avatar, Recording
from handbench.methods.geometry.config import configuration as geometry_preset
from handbench.methods.geometry.model import GeometryModel
from handbench.methods.geometry.scan import PointCloud
from handbench.methods.geometry.training import Lesson as GeometryLesson
from handbench.methods.kit import picture
from handbench.methods.kit.views import views
from handbench.methods.relightablehands.config import PRESETS as RELIGHTABLE
from handbench.methods.relightablehands.method import RelightableHandsAvatar
from handbench.methods.relightablehands.model import RelightableHandsModel, ViewedTexels, lit
from handbench.methods.relightablehands.training import Lesson as RelightableHandsLesson
from handbench.methods.urhand import lighting
from handbench.methods.urhand.config import configuration
from handbench.methods.urhand.method import URHandAvatar
from handbench.methods.urhand.model import URHandModel
from handbench.methods.urhand.training import Lesson as URHandLesson
from handbench.render.see.raster import rasterise
from handbench.render.shade import shading
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Camera, Mesh
from handbench.skips import NONE, Skips, skipping

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
def all_on_meta(some: Skips = NONE) -> Iterator[None]:
    """With what would look at values left out: skips by light, checks for NaN, whether light is white."""
    with pytest.MonkeyPatch.context() as patch, torch.no_grad(), skipping(some), _OneDevice():
        patch.setattr(shading, "_checked", lambda **maps: tuple(maps.values()))
        patch.setattr(torch, "equal", lambda *_: False)
        patch.setattr(torch.sparse, "mm", product)  # torch has none for meta
        yield


def product(matrix: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    assert matrix.device == values.device
    return values.new_empty(matrix.shape[0], values.shape[1])


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
        seen = ViewedTexels.of(surface, np.ones(3), torch.zeros(20, 3))
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
    camera = Camera("front", 48, 64, [[200, 0, 24], [0, 200, 32], [0, 0, 1]], np.eye(3, 4))

    with all_on_meta():
        points = np.asarray(hand.points)
        mean, _ = model.encode(PointCloud(np.zeros((4, 3)), np.eye(4, 3), np.ones(4)), points)
        shape = model.shape(mean)
        told = model.told(shape, points)
        beyond = model.beyond(torch.zeros(3, size.image, size.image), camera, points, told)
        posed = model.posed(shape, told, beyond)
    assert {each.device for each in (mean, shape.vertices, beyond, posed.vertices, posed.correctives)} == {META}
    assert posed.vertices.shape == hand.rest_position(1).shape


# -- whole calls ------------------------------------------------------------------------------------------------

OF_VALUES = Skips(dark_lights=False, occluded=False, below_horizon=False)  # off: they look at values


@pytest.fixture(scope="module")
def selected() -> Selected:
    return resolve(find_protocol("smoke"), open_capture("mini").frames())


@pytest.fixture(scope="module")
def recording(selected: Selected) -> Recording:
    """All frames of one pose of a training subject."""
    first = selected.train[0]
    frames = [f for f in selected.train if f.subject == first.subject]
    return Recording(frames, open_capture("mini").observe)


def _urhand() -> Avatar:
    config = replace(configuration("smoke"), texture=64)
    return URHandAvatar(URHandModel(config, 21).eval().to(META), torch.rand(3, 64, 64, device=META))


def _relightablehands() -> Avatar:
    return RelightableHandsAvatar(RelightableHandsModel(RELIGHTABLE["smoke"], 21, 0.3).eval().to(META))


@pytest.mark.parametrize("made", [_urhand, _relightablehands])
def test_a_picture_leaves_its_device_at_the_end_alone(made, selected: Selected, monkeypatch) -> None:
    left: list[torch.Tensor] = []

    def out(image: torch.Tensor) -> np.ndarray:
        left.append(image)
        return np.zeros(image.shape, np.float32)

    monkeypatch.setattr(picture, "on_host", out)
    frames = {f.kind: f for column in selected.scored.values() for f in column}
    assert {"olat", "environment"} <= frames.keys()
    for frame in frames.values():
        with all_on_meta(OF_VALUES):
            made().relight(frame.query)
    assert [(each.device, each.shape[2]) for each in left] == [(META, 3)] * len(frames)


@pytest.mark.parametrize("preset", ["smoke", "standard"])
def test_a_training_step_of_urhand_stays_on_its_device(recording: Recording, preset: str) -> None:
    config = replace(configuration(preset), texture=64)
    lesson = URHandLesson(URHandModel(config, 21).to(META), recording)
    with all_on_meta():
        losses = lesson.losses(0, np.random.default_rng(0))
        if lesson.discriminator is not None:
            losses = {**losses, **lesson.adversary(0, np.random.default_rng(0))}
    assert {loss.device for loss in losses.values()} == {META} and losses.keys() >= {"l1", "perceptual"}


def test_a_training_step_of_relightablehands_stays_on_its_device(recording: Recording) -> None:
    config = RELIGHTABLE["smoke"]
    seen = views(recording, config.texture, device=META)
    with all_on_meta():
        lesson = RelightableHandsLesson(RelightableHandsModel(config, 21, 0.3).to(META), seen)
        losses = lesson.losses(0, np.random.default_rng(0))
    assert {loss.device for loss in losses.values()} == {META}


def test_a_training_step_of_the_geometry_autoencoder_stays_on_its_device(recording: Recording) -> None:
    lesson = GeometryLesson(GeometryModel(geometry_preset("smoke"), OpenHand.load(), 1).to(META), recording)
    for seed in range(2):  # a recorded hand and a deformed one
        with all_on_meta():
            losses = lesson.losses(0, np.random.default_rng(seed))
        assert {loss.device for loss in losses.values()} == {META}


# -- who copies -------------------------------------------------------------------------------------------------

METHODS = Path(handbench.methods.__file__).parent
ON_DEVICE = {"geometry", "relightablehands", "urhand"}
"""The families that ask for a device. All others work on the CPU, whatever is asked for, and copy nothing."""


def test_nothing_else_copies_from_a_device() -> None:
    calling: dict[str, set[str]] = {"cpu": set(), "numpy": set(), "item": set()}
    for path in METHODS.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in calling:
                calling[node.func.attr].add(path.relative_to(METHODS).as_posix())
    assert calling["cpu"] == {"kit/host.py", "kit/checkpoint.py"}, "a digest of weights is no forward pass"
    allowed = {
        "geometry/nearest.py",  # Embree, on the CPU alone
        "geometry/skeleton.py",  # key points of the capture's pose, which is the CPU's
    }
    copying = {path for path in calling["numpy"] | calling["item"] if path.split("/")[0] in ON_DEVICE}
    assert copying == allowed


def test_which_methods_ask_for_a_device() -> None:
    asking = {
        path.relative_to(METHODS).parts[0]
        for path in METHODS.rglob("*.py")
        if "from handbench.device import" in path.read_text()
    }
    assert asking == ON_DEVICE
