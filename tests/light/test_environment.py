from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch

from handbench.data.environments import read_environment
from handbench.errors import InputError
from handbench.light.environment import (
    _overlaps,
    directions,
    places,
    places_of,
    resize,
    rotate,
    solid_angles,
    texels,
    to_directional,
)
from handbench.light.stage import stage_directions
from handbench.scene import Environment


def random_map(height: int, width: int, seed: int = 0) -> Environment:
    """A map with a sun: most texels dim, one very bright."""
    radiance = np.random.default_rng(seed).random((height, width, 3))
    radiance[height // 3, width // 5] = 5000.0
    return Environment("random", radiance)


def power(environment: Environment) -> np.ndarray:
    return (environment.radiance * solid_angles(*environment.radiance.shape[:2])[..., None]).sum(axis=(0, 1))


@pytest.mark.parametrize(
    ("height", "width"), [(1, 1), (1, 2), (2, 4), (7, 5), (16, 32), (33, 101), (999, 3), (256, 512)]
)
def test_solid_angles_fill_the_sphere(height: int, width: int) -> None:
    assert abs(math.fsum(solid_angles(height, width).ravel()) - 4 * np.pi) < 1e-12


def test_solid_angles_are_exact_at_the_poles() -> None:
    # 1 - cos x = 2 sin^2(x / 2) in the first row; twelve digits, where a difference of cosines has ten
    height, width = 4096, 10
    expected = 2 * math.sin(np.pi / height / 2) ** 2 * 2 * np.pi / width
    found = solid_angles(height, width)
    assert np.allclose(found[0], expected, rtol=1e-14, atol=0) and np.allclose(found[-1], expected, rtol=2e-12, atol=0)


def test_directions_follow_the_documented_azimuth() -> None:
    middle = directions(2, 4)  # centres at azimuths 45, 135, 225, 315 degrees
    assert np.allclose(np.linalg.norm(middle, axis=-1), 1)
    assert (middle[0, :, 1] > 0).all() and (middle[1, :, 1] < 0).all()
    half = 0.5
    assert np.allclose(middle[0, :, [0, 2]].T, [[half, -half], [half, half], [-half, half], [-half, -half]])


def test_solid_angles_match_the_directions() -> None:
    # the integral of x^2 over the sphere is 4 pi / 3, and of x is 0: only right weights at right places give it
    towards, weights = directions(128, 256), solid_angles(128, 256)[..., None]
    assert np.allclose((towards**2 * weights).sum(axis=(0, 1)), 4 * np.pi / 3, rtol=2e-4)
    assert np.allclose((towards * weights).sum(axis=(0, 1)), 0, atol=1e-12)


@pytest.mark.parametrize("size", [(16, 32), (7, 13), (1, 1), (64, 128), (90, 200)])
def test_resize_keeps_the_power(size: tuple[int, int]) -> None:
    environment = random_map(64, 128)
    assert np.allclose(power(resize(environment, *size)), power(environment), rtol=1e-6)


def test_resize_by_whole_factors_is_the_weighted_mean() -> None:
    environment, weights = random_map(8, 16), solid_angles(8, 16)[..., None]
    blocks = lambda values: values.reshape(4, 2, 8, 2, -1).sum(axis=(1, 3))  # noqa: E731
    expected = blocks(environment.radiance * weights) / blocks(weights)
    assert np.allclose(resize(environment, 4, 8).radiance, expected, rtol=1e-6)


def test_resize_of_a_constant_is_the_constant() -> None:
    small = resize(Environment("grey", np.full((31, 57, 3), 0.7)), 16, 32)
    assert np.allclose(small.radiance, 0.7, rtol=1e-6)


def test_a_tensor_points_where_an_array_does() -> None:
    towards = np.concatenate([directions(9, 14).reshape(-1, 3), np.eye(3), -np.eye(3)])
    of_tensor = places_of(torch.from_numpy(towards), 6, 11)
    for mine, truth in zip(of_tensor, places(towards, 6, 11), strict=True):
        np.testing.assert_allclose(mine.numpy(), truth, rtol=0, atol=1e-12)


def test_texels_are_summed_in_one_order() -> None:
    """Bit for bit the sum from the first to the last: what threads share out (a dense product) is summed otherwise."""
    radiance = random_map(37, 3).radiance.reshape(37, -1).astype(np.float64)
    shares = _overlaps(np.linspace(0.0, 1.0, 5), np.linspace(0.0, 1.0, 38))
    for row, found in zip(shares.toarray(), shares @ radiance, strict=True):
        total = np.zeros(9)
        for share, texel in zip(row, radiance, strict=True):
            total += share * texel
        assert found.tobytes() == total.tobytes()


def test_a_turn_by_whole_columns_turns_the_lights() -> None:
    environment, angle = random_map(16, 32), 5 * 2 * np.pi / 32
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    before, after = to_directional(environment), to_directional(rotate(environment, angle))
    order = lambda where: np.lexsort(np.round(where, 6).T)  # noqa: E731
    turned = before[0] @ turn.T
    assert np.allclose(turned[order(turned)], after[0][order(after[0])], atol=1e-6)
    assert np.allclose(before[1][order(turned)], after[1][order(after[0])], rtol=1e-5)


@pytest.mark.parametrize("angle", [0.0, 0.1, -2.0, 7.0])
def test_a_turn_keeps_the_power_and_turns_back(angle: float) -> None:
    environment = random_map(16, 32)
    assert np.allclose(power(rotate(environment, angle)), power(environment), rtol=1e-5)
    whole = round(angle / (2 * np.pi) * 32) * 2 * np.pi / 32
    assert np.allclose(rotate(rotate(environment, whole), -whole).radiance, environment.radiance, rtol=1e-4)


def test_directional_lights_carry_the_power_and_skip_the_dark() -> None:
    environment = random_map(64, 128)
    towards, irradiance = to_directional(environment)
    assert towards.shape == irradiance.shape == (512, 3) and towards.dtype == irradiance.dtype == np.float64
    assert np.allclose(irradiance.sum(axis=0), power(environment), rtol=1e-6)
    dark = environment.radiance.copy()
    dark[32:] = 0
    assert len(to_directional(Environment("dark", dark))[0]) == 256
    assert to_directional(environment.scaled(0.0))[0].shape == (0, 3)


def write_exr(path: Path, image: np.ndarray) -> None:
    channels = {name: np.ascontiguousarray(image[..., i]) for i, name in enumerate("RGB")}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(path))


def test_exr_round_trip(tmp_path: Path) -> None:
    image = random_map(8, 16).radiance
    write_exr(tmp_path / "sky.exr", image)
    environment = read_environment(tmp_path / "sky.exr")
    assert environment.name == "sky" and np.array_equal(environment.radiance, image)


def test_hdr_is_decoded(tmp_path: Path) -> None:
    # flat RGBE: radiance = mantissa 2^(exponent - 136)
    texels = np.tile(np.array([[128, 64, 32, 129]], dtype=np.uint8), (2 * 4, 1))
    texels[3] = (255, 0, 128, 140)
    path = tmp_path / "sky.hdr"
    path.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n" + texels.tobytes())
    radiance = read_environment(path).radiance
    assert np.allclose(radiance[0, 0], [1.0, 0.5, 0.25]) and np.allclose(radiance[0, 3], [4080, 0, 2048])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.exr", None, "does not exist"),
        ("text.exr", b"hello", "damaged"),
        ("text.hdr", b"hello", "damaged"),
        ("cut.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n\x01\x02", "damaged"),
        ("sky.png", b"", "convert"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, name: str, content: bytes | None, message: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=f"{name}.*{message}"):
        read_environment(tmp_path / name)


@pytest.mark.parametrize(("value", "message"), [(np.nan, "NaN"), (-1.0, "negative")])
def test_bad_radiance_is_named(tmp_path: Path, value: float, message: str) -> None:
    image = random_map(4, 8).radiance.copy()
    image[1, 2] = value
    write_exr(tmp_path / "bad.exr", image)
    with pytest.raises(InputError, match=f"bad.*{message}"):
        read_environment(tmp_path / "bad.exr")


def test_truncated_exr_is_named(tmp_path: Path) -> None:
    write_exr(tmp_path / "cut.exr", random_map(64, 128).radiance)
    data = (tmp_path / "cut.exr").read_bytes()
    (tmp_path / "cut.exr").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match=r"cut\.exr"):
        read_environment(tmp_path / "cut.exr")


def test_a_map_that_is_not_equirectangular_is_named(tmp_path: Path) -> None:
    write_exr(tmp_path / "square.exr", random_map(8, 8).radiance)
    with pytest.raises(InputError, match="8x8"):
        read_environment(tmp_path / "square.exr")


@pytest.mark.parametrize("count", [1, 24, 350])
def test_stage_directions_are_spread(count: int) -> None:
    towards = stage_directions(count)
    assert np.allclose(np.linalg.norm(towards, axis=1), 1)
    if count > 1:
        assert np.linalg.norm(towards.mean(axis=0)) < 1.5 / count
        cosines = towards @ towards.T - 2 * np.eye(count)
        # the best packing's nearest neighbours are about sqrt(4 pi / count * 2 / sqrt(3)) apart
        assert np.arccos(cosines.max()) > 0.75 * np.sqrt(4 * np.pi / count * 2 / np.sqrt(3))
    with pytest.raises(InputError):
        stage_directions(0)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (5, 7), (16, 32)])
def test_a_direction_points_into_the_texel_whose_centre_it_is(height: int, width: int) -> None:
    row, column = texels(directions(height, width), height, width)
    assert np.array_equal(row, np.arange(height)[:, None].repeat(width, axis=1))
    assert np.array_equal(column, np.arange(width)[None].repeat(height, axis=0))


def test_the_border_of_a_map_is_shared_by_its_ends() -> None:
    # just to either side of -z; straight up and down stay inside
    beside = np.array([[1e-3, 0.0, -1.0], [-1e-3, 0.0, -1.0]])
    assert np.array_equal(texels(beside, 4, 8)[1], [0, 7])
    assert np.array_equal(texels(np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]), 4, 8)[0], [0, 3])
