from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from itertools import accumulate
from typing import Any

import numpy as np
import pytest
import torch
from torch.profiler import ProfilerActivity, profile

from handbench.light.lightset import LightSet
from handbench.render.shade import fused, switch, tiles
from handbench.render.shade.brdf import specular
from handbench.render.shade.reference import shading_features
from handbench.render.shade.shading import light_features
from handbench.scene import Array

CENTRE = np.array([0.1, 0.2, 2.0])
NONE = np.zeros((0, 3))


def texels(count: int, seed: int = 0, dtype: torch.dtype = torch.float64):
    generator = torch.Generator().manual_seed(seed)
    normal = torch.nn.functional.normalize(torch.randn(3, count, generator=generator, dtype=dtype), dim=0)
    position = 0.1 * torch.randn(3, count, generator=generator, dtype=dtype)
    roughness = 0.1 + 0.9 * torch.rand(count, generator=generator, dtype=dtype)
    return normal, position, roughness


def distant(count: int, seed: int = 0) -> LightSet:
    random = np.random.default_rng(seed)
    towards = random.normal(size=(count, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    return LightSet(towards, random.random((count, 3)), NONE, NONE)


def views(position: torch.Tensor) -> np.ndarray:
    view = CENTRE - position.numpy().T
    return view / np.linalg.norm(view, axis=1, keepdims=True)


@pytest.mark.parametrize(("dtype", "rtol"), [(torch.float64, 1e-10), (torch.float32, 2e-4)])
def test_features_are_the_reference(dtype: torch.dtype, rtol: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "_PAIRS", 1000)  # many tiles, the last ones partial
    monkeypatch.setattr(tiles, "LIGHTS", 7)
    normal, position, roughness = texels(333, dtype=torch.float64)
    lights = distant(23)
    seen = np.random.default_rng(1).random((23, 333)) < 0.7
    expected = shading_features(
        normal.numpy().T, views(position), roughness.numpy(), lights.directions, lights.irradiance, seen
    )
    features = light_features(normal.to(dtype), position.to(dtype), roughness.to(dtype), CENTRE, lights, seen)
    for ours, theirs in zip(features, expected, strict=True):
        assert ours.dtype == dtype
        assert np.allclose(ours.numpy(), theirs.T, rtol=rtol, atol=rtol * theirs.max())


def test_features_are_linear_in_the_lights() -> None:
    maps, lights = texels(50), distant(9)
    towards = np.concatenate([lights.directions] * 2)
    power = np.concatenate([2 * lights.irradiance, 0.5 * lights.irradiance])
    stacked = LightSet(towards, power, NONE, NONE)
    for model in ("brdf", "phong", "diffuse"):
        once, twice = (light_features(*maps, CENTRE, some, model=model) for some in (lights, stacked))
        for a, b in zip(once, twice, strict=True):
            assert torch.allclose(2.5 * a, b, rtol=1e-10)


def test_dark_lights_and_tiles_do_not_change_the_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    maps, lights = texels(100), distant(40)
    power = lights.irradiance.copy()
    power[::3] = 0
    seen = np.random.default_rng(1).random((40, 100)) < 0.7
    skipped = light_features(*maps, CENTRE, LightSet(lights.directions, power, NONE, NONE), seen)
    kept = torch.tensor(power, requires_grad=True)  # a light that needs a gradient is never skipped
    monkeypatch.setattr(tiles, "_KEEP", 10)  # and tiles are recomputed in the backward pass
    whole = light_features(*maps, CENTRE, LightSet(lights.directions, kept, NONE, NONE), seen)
    for a, b in zip(skipped, whole, strict=True):
        assert torch.allclose(a, b, rtol=1e-12)
    (gradient,) = torch.autograd.grad(whole[0].sum(), kept)
    cosines = np.maximum(lights.directions @ maps[0].numpy(), 0) * seen
    assert np.allclose(gradient.numpy(), cosines.sum(axis=1, keepdims=True), rtol=1e-10)


def test_near_lights_far_away_are_distant_ones() -> None:
    maps, lights = texels(60), distant(5)
    far = 1e5
    near = LightSet(NONE, NONE, lights.directions * far, lights.irradiance * far**2)
    for model in ("brdf", "phong", "diffuse"):
        for a, b in zip(*(light_features(*maps, CENTRE, some, model=model) for some in (lights, near)), strict=True):
            assert torch.allclose(a, b, rtol=1e-4, atol=1e-5 * float(a.max()))


def test_a_near_light_falls_off_with_the_square() -> None:
    normal = torch.tensor([[0.0], [1.0], [0.0]])
    lamp = lambda height: LightSet(NONE, NONE, np.array([[0.0, height, 0.0]]), np.full((1, 3), 8.0))  # noqa: E731
    for height in (0.5, 2.0):
        diffuse, _ = light_features(normal, torch.zeros(3, 1), torch.ones(1), CENTRE, lamp(height))
        assert torch.allclose(diffuse, torch.tensor(8.0 / height**2))


def test_visibility_rows_are_distant_then_near() -> None:
    normal, position = torch.tensor([[0.0], [1.0], [0.0]]), torch.zeros(3, 1)
    both = LightSet(
        np.array([[0.0, 1.0, 0.0]]), np.array([[1.0, 0, 0]]), np.array([[0.0, 1.0, 0.0]]), np.array([[0, 1.0, 0]])
    )
    for row, expected in enumerate(([1.0, 0, 0], [0, 1.0, 0])):
        seen = np.arange(2)[:, None] == row
        diffuse, _ = light_features(normal, position, torch.ones(1), CENTRE, both, seen)
        assert diffuse[:, 0].tolist() == expected


def test_specular_feature_is_the_elementwise_brdf() -> None:
    normal, position, roughness = texels(40)
    lights = distant(1)
    _, ours = light_features(normal, position, roughness, CENTRE, lights)
    towards = torch.tensor(lights.directions[0])
    lobe = specular(normal.T, torch.tensor(views(position)), towards, roughness)
    expected = lobe * (towards @ normal).clamp_min(0) * torch.tensor(lights.irradiance[0])[:, None]
    assert torch.allclose(ours, expected, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("model", ["brdf", "phong", "diffuse"])
@pytest.mark.parametrize("keep", [1 << 20, 1])
def test_gradients_are_those_of_finite_differences(model: str, keep: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "_KEEP", keep)
    monkeypatch.setattr(tiles, "_PAIRS", 12)
    normal, position, roughness = texels(4, seed=3)  # a tile of three, and one of one
    lights = distant(4, seed=2)

    def features(n, x, roughness, irradiance, intensity):
        near = LightSet(lights.directions, irradiance, 2 * lights.directions[:1], intensity)
        return light_features(torch.nn.functional.normalize(n, dim=0), x, roughness, CENTRE, near, model=model)

    inputs = [normal, position, roughness, torch.tensor(lights.irradiance), torch.ones(1, 3, dtype=torch.float64)]
    assert torch.autograd.gradcheck(features, [value.clone().requires_grad_() for value in inputs])


def test_values_and_gradients_are_finite_at_the_limits() -> None:
    up, down, side = [0.0, 0, 1], [0.0, 0, -1], [1.0, 0, 0]
    normal = torch.tensor([up, down, side, [0.6, 0, 0.8]]).T.repeat(1, 3).requires_grad_()
    roughness = torch.tensor([0.0, 0.02, 1.0]).repeat_interleave(4).requires_grad_()
    centre = np.array([0, 0, 1.0])
    lights = LightSet(
        np.array([up, down, side, [-1.0, 0, 0]]), np.ones((4, 3)), np.array([[0, 0, 0.0]]), np.ones((1, 3))
    )
    for model in ("brdf", "phong"):
        features = light_features(normal, torch.zeros(3, 12), roughness, centre, lights, model=model)
        assert all(values.isfinite().all() for values in features)
        for gradient in torch.autograd.grad(
            sum(values.sum() for values in features), (normal, roughness), allow_unused=True
        ):
            assert gradient is None or gradient.isfinite().all()


def test_no_light_is_black() -> None:
    maps = texels(5)
    for values in light_features(*maps, CENTRE, LightSet(NONE, NONE, NONE, NONE)):
        assert values.shape == (3, 5) and not values.any()


@pytest.mark.parametrize("roughness", [0.02, 0.05, 0.2, 1.0])
def test_float32_keeps_five_digits_at_every_angle(
    roughness: float, fuse: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Relative error of every single value that the float64 reference says is not zero, one light at a time.

    The inputs are what float32 maps hold, so the rounding of a normal is not judged, and all that follows is.
    """
    random = np.random.default_rng(0)
    single = torch.tensor(random.normal(size=(3, 600))).float()
    normal = torch.nn.functional.normalize(single, dim=0)
    position = 0.1 * torch.tensor(random.normal(size=(3, 600))).float()
    exact = torch.nn.functional.normalize(normal.double(), dim=0).numpy()
    view = views(position.double()).T
    mirror = 2 * (exact * view).sum(0) * exact - view
    # lights in the lobes of texels (those with the viewer near their horizon, too), on horizons, opposite, anywhere
    low = np.argsort(np.abs((exact * view).sum(0)))[:8]
    near = mirror[:, np.r_[low, :8]] + random.normal(size=(3, 16)) * roughness**2 * random.random(16)
    tangent = np.cross(exact[:, 8:16].T, random.normal(size=(8, 3))).T
    horizon = tangent / np.linalg.norm(tangent, axis=0) + exact[:, 8:16] * np.geomspace(1e-6, 1e-2, 8)
    towards = np.concatenate([near, horizon, -view[:, low[:4]], random.normal(size=(3, 12))], axis=1).T
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    rough = np.full(600, np.float32(roughness), dtype=np.float64)
    # light l shines in channel l alone
    expected = shading_features(exact.T, view.T, rough, towards, np.eye(40), np.ones((40, 600)))
    for path in ("tiles", "fused"):
        monkeypatch.setattr(switch, "_FUSE", 1 << 60)
        if path == "fused":
            fuse()
        for direction, *theirs in zip(towards, *(feature.T for feature in expected), strict=True):
            lights = LightSet(direction[None], np.ones((1, 3)), NONE, NONE)
            found = light_features(normal, position, torch.tensor(rough).float(), CENTRE, lights)
            for ours, one in zip(found, theirs, strict=True):
                lit = one > 1e-30
                assert np.allclose(ours.numpy()[:, lit], one[lit], rtol=1e-5, atol=0), path


@pytest.mark.parametrize("path", ["tiles", "fused", "tiles, gradient", "fused, gradient"])
def test_memory_is_bounded_whatever_the_number_of_lights(
    path: str, fuse: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    count, number = 20000, 200
    for least in ("_FUSE", "_DRAW"):
        monkeypatch.setattr(switch, least, 1 << 60)
    if path.startswith("fused"):
        count, number = 1000, 5000
        fuse()
    normal, position, roughness = texels(count, dtype=torch.float32)
    normal.requires_grad_("gradient" in path)
    lights, seen = distant(number), np.ones((number, count), dtype=bool)

    def work(lights: LightSet, seen: Array) -> None:
        specular = light_features(normal, position, roughness, CENTRE, lights, seen)[1]
        if normal.requires_grad:
            specular.sum().backward()

    work(distant(8), seen[:8])  # what is loaded and compiled is kept
    taken = _of_torch(lambda: work(lights, seen))
    if path.startswith("fused"):
        taken += _of_numpy(lambda: work(lights, seen)) + _of_xla(lambda: work(distant(8), seen[:8]), monkeypatch)
    # without tiles there would be a dozen buffers of lights x texels; tiles of fixed size need less than one
    assert 0 < taken < 4 * number * count


# Counted by who allocates: what is resident in a process depends on what it has freed and kept before.


def _of_torch(work: Callable[[], None]) -> int:
    """Bytes that torch holds at most for what a call makes."""
    with profile(activities=[ProfilerActivity.CPU], profile_memory=True) as found:
        work()
    events = [event for event in found.profiler.kineto_results.events() if event.name() == "[memory]"]
    steps = (event.nbytes() for event in sorted(events, key=lambda event: event.start_ns()))
    return max(accumulate(steps))


def _of_numpy(work: Callable[[], None]) -> int:
    """Bytes that numpy, and Python, hold at most for what a call makes."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def _of_xla(work: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> int:
    """Bytes that the largest kernel of a call takes: arguments, answers and what is between."""
    kernel, found = fused._kernel, dict[str, int]()

    def watched(model: str, what: Any) -> Callable[..., Any]:
        compiled = kernel(model, what)

        def call(*arguments: Any) -> Any:
            if what not in found:  # all blocks have one shape
                sizes = compiled.lower(*arguments).compile().memory_analysis()
                found[what] = sizes.argument_size_in_bytes + sizes.output_size_in_bytes + sizes.temp_size_in_bytes
            return compiled(*arguments)

        return call

    monkeypatch.setattr(fused, "_kernel", watched)
    work()
    return max(found.values())
