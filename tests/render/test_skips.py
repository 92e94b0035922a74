"""What is skipped changes no picture, and is told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from handbench.light.lightset import LightSet
from handbench.render.see.raster import rasterise
from handbench.render.shade import switch, tiles
from handbench.render.shade.shading import light_features
from handbench.render.uv.atlas import Atlas
from handbench.skips import NONE, Saved, Skips, skipping, tallied

CENTRE = np.array([0.1, 0.2, 2.0])


@pytest.fixture(params=["tiles", "fused"])
def path(request, monkeypatch: pytest.MonkeyPatch, fuse: Callable[[], None]) -> str:
    fuse()
    if request.param == "tiles":
        monkeypatch.setattr(switch, "_FUSE", 1 << 60)
        monkeypatch.setattr(tiles, "_PAIRS", 2048)
    return request.param


@pytest.fixture
def scene():
    """Texels in runs of alike normals, so that whole blocks look away from a light; a third of the lights dark."""
    random = np.random.default_rng(0)
    corners = random.normal(size=(3, 10)).repeat(64, axis=1) + 0.1 * random.normal(size=(3, 640))
    normal = torch.nn.functional.normalize(torch.tensor(corners), dim=0).float()
    towards = random.normal(size=(60, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    power = random.random((60, 3))
    power[::3] = 0.0
    lights = LightSet(towards, power, np.zeros((0, 3)), np.zeros((0, 3)))
    seen = (towards @ normal.double().numpy() > 0) & (random.random((60, 640)) < 0.7)
    return [normal, 0.05 * normal.flip(0), torch.full((640,), 0.4), CENTRE, lights], seen


@pytest.mark.parametrize("switch", ["dark_lights", "occluded", "below_horizon", "missing_lobes", "all"])
@pytest.mark.parametrize("model", ["brdf", "phong", "diffuse"])
def test_features_do_not_change(scene, path: str, model: str, switch: str) -> None:
    arguments, seen = scene
    off = NONE if switch == "all" else replace(Skips(), **{switch: False})
    for visibility in (seen, None):
        on = light_features(*arguments, visibility, model)
        with skipping(off):
            plain = light_features(*arguments, visibility, model)
        for ours, expected in zip(on, plain, strict=True):
            assert (ours - expected).abs().max() <= 1e-6 * expected.abs().max()


def test_fused_blocks_are_skipped_to_the_bit(scene, path: str) -> None:
    arguments, seen = scene
    if path == "fused":  # a term of zero changes no sum
        for visibility in (seen, None):
            on = light_features(*arguments, visibility)
            with skipping(replace(Skips(), occluded=False, below_horizon=False)):
                assert all(map(torch.equal, on, light_features(*arguments, visibility)))


def test_what_is_skipped_is_told(scene, path: str) -> None:
    arguments, seen = scene
    with tallied() as tally:
        light_features(*arguments, seen)
    lines = tally.lines()
    assert lines["dark lights"] == Saved(60, 20)
    assert lines["texel-light pairs"].total == 40 * 640
    # every one of the ten runs of texels looks away from about half of the lights
    blocks = seen[np.arange(60) % 3 > 0].reshape(40, 10, 64).any(axis=2)
    if path == "fused":
        assert lines["texel-light pairs"].skipped == (~blocks).sum() * 64 > 0.3 * 40 * 640
    with tallied() as tally, skipping(NONE):
        light_features(*arguments, seen, "diffuse")
    assert all(saved.skipped == 0 for saved in tally.lines().values())


def test_gradients_do_not_change(scene, path: str) -> None:
    arguments, seen = scene

    def gradients() -> tuple[torch.Tensor, ...]:
        inputs = [values.clone().requires_grad_() for values in arguments[:3]]
        return torch.autograd.grad(light_features(*inputs, *arguments[3:], seen)[1].sum(), inputs)

    on = gradients()
    with skipping(NONE):
        for ours, expected in zip(on, gradients(), strict=True):
            assert (ours - expected).abs().max() <= 2e-6 * expected.abs().max()


def test_an_all_dark_scene_is_black_and_has_gradients(scene, path: str) -> None:
    arguments, seen = scene
    normal = arguments[0].clone().requires_grad_()
    specular = light_features(normal, *arguments[1:], np.zeros_like(seen))[1]
    assert not specular.any()
    (gradient,) = torch.autograd.grad(specular.sum(), normal)
    assert not gradient.any()


def test_an_atlas_of_every_texel_draws_the_same_maps(shapes) -> None:
    mesh = shapes.sphere(8, 16)
    few = Atlas.of(mesh.topology, 32)
    with skipping(replace(Skips(), uncovered=False)):
        every = Atlas.of(mesh.topology, 32)
    assert every is not few and every.count == 32 * 32 > few.count
    assert np.array_equal(every.covered, few.covered)
    texture = torch.rand(2, 32, 32)
    # a copy is worked on as its original is, and is not written
    for one, other in ((few, every), (every, few)):
        ours = [atlas.scatter(atlas.gather(texture).square()) for atlas in (one, other)]
        assert torch.equal(*ours)
        assert torch.equal(one.dilate(ours[0]), other.dilate(ours[1]))
        assert torch.equal(one.dilate(ours[0], 2), other.dilate(ours[1], 2))
    assert np.array_equal(every.face[few.texels], few.face)
    points = torch.from_numpy(every.interpolate(mesh.vertices).T)
    fewer = torch.from_numpy(few.interpolate(mesh.vertices).T)
    assert torch.equal(points.reshape(3, 32, 32), few.dilate(few.scatter(fewer)))
    value = texture.clone().requires_grad_()  # an original gets its gradient once, not once a copy
    (gradient,) = torch.autograd.grad(every.scatter(every.gather(value)).sum(), value)
    assert torch.equal(gradient, torch.from_numpy(few.covered).float().expand(2, -1, -1))


def test_needed_texels_are_all_that_a_picture_looks_up(shapes) -> None:
    mesh, camera = shapes.sphere(12, 24), shapes.camera(40, 32, focal=60.0)
    atlas, picture = Atlas.of(mesh.topology, 48), rasterise(mesh, camera)
    needed = torch.from_numpy(atlas.needed(picture.texels(48)))
    assert 0.2 < needed.float().mean() < 0.7
    values = torch.rand(3, atlas.count)
    image = picture.sample(atlas.dilate(atlas.scatter(values)))
    assert torch.equal(image, picture.sample(atlas.dilate(atlas.scatter(values * needed))))
    spoilt = values.clone()
    spoilt[:, torch.nonzero(needed)[7, 0]] += 1.0  # and each of them is
    assert not torch.equal(image, picture.sample(atlas.dilate(atlas.scatter(spoilt))))


def test_pixels_outside_the_box_see_nothing(shapes) -> None:
    mesh, camera = shapes.sphere(12, 24), shapes.camera(60, 40, focal=60.0)
    with tallied() as tally:
        boxed = rasterise(mesh, camera)
    assert tally.lines()["camera rays"].total == 60 * 40 * 9 and tally.lines()["camera rays"].skipped > 60 * 40 * 4
    with skipping(replace(Skips(), outside_box=False)), tallied() as tally:
        whole = rasterise(mesh, camera)
    assert tally.lines()["camera rays"].skipped == 0
    for name in ("pixel", "face", "barycentric", "depth"):
        assert np.array_equal(getattr(boxed, name), getattr(whole, name)), name


def test_known_lookups_are_used_again(shapes) -> None:
    mesh = shapes.sphere(8, 16)
    picture, texture = rasterise(mesh, shapes.camera()), torch.rand(3, 16, 16)
    first = picture.sample(texture)
    with tallied() as tally:
        again = picture.sample(texture)
    assert tally.lines()["texture lookups"] == Saved(1, 1)
    assert torch.equal(first, again)
