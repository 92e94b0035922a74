from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from handbench.data.ktx import read_ktx, unpack_11_11_10
from handbench.errors import InputError
from handbench.light.environment import directions, solid_angles
from handbench.light.skybox import (
    SKYBOXES,
    _direction,
    _locate,
    equirectangular,
    skybox,
)


@pytest.mark.parametrize(
    ("red", "green", "blue", "expected"),
    [
        (0x3C0, 0, 0, (1, 0, 0)),
        (0, 0x3C0, 0, (0, 1, 0)),
        (0, 0, 0x1E0, (0, 0, 1)),
        (0x7BF, 0x7BF, 0x3DF, (65024, 65024, 64512)),  # the largest finite values
        (1, 1, 1, (2**-20, 2**-20, 2**-19)),  # the smallest
        (0x3E0, 0x380, 0x1F0, (1.5, 0.5, 1.5)),
    ],
)
def test_packed_floats(red: int, green: int, blue: int, expected: tuple[float, ...]) -> None:
    packed = np.array([red | green << 11 | blue << 22], dtype=np.uint32)
    assert np.array_equal(unpack_11_11_10(packed)[0], np.array(expected, dtype=np.float32))


def ktx(texels: np.ndarray, **changes: int) -> bytes:
    header = {
        "endian": 0x04030201,
        "type": 0x8C3A,
        "type_size": 1,
        "format": 0x1907,
        "internal": 0x8C3A,
        "base": 0x1907,
    }
    header |= {
        "width": texels.shape[1],
        "height": texels.shape[1],
        "depth": 0,
        "array": 0,
        "faces": 6,
        "mips": 1,
        "extra": 4,
    }
    header |= changes
    start = b"\xabKTX 11\xbb\r\n\x1a\n" + struct.pack("<13I", *header.values()) + b"note"
    return start + struct.pack("<I", texels[0].nbytes) + texels.tobytes()


def test_cube_file_is_read(tmp_path: Path) -> None:
    ones = np.arange(6, dtype=np.uint32)[:, None, None] * np.ones((1, 4, 4), dtype=np.uint32)
    (tmp_path / "a.ktx").write_bytes(ktx(ones))
    faces = read_ktx(tmp_path / "a.ktx")
    assert faces.shape == (6, 4, 4, 3)
    assert np.allclose(faces[..., 0], np.arange(6)[:, None, None] * 2.0**-20) and not faces[..., 1:].any()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (bytes(80), "no little-endian KTX"),
        (ktx(np.zeros((6, 4, 4), np.uint32))[:-1], "ends after"),
        (ktx(np.zeros((6, 4, 4), np.uint32), faces=3), "3 faces"),
        (ktx(np.zeros((6, 4, 4), np.uint32), internal=0x8058), "0x8058"),
    ],
)
def test_damaged_cube_files_are_named(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "bad.ktx").write_bytes(content)
    with pytest.raises(InputError, match=f"bad.ktx.*{message}"):
        read_ktx(tmp_path / "bad.ktx")


def test_faces_look_where_they_should() -> None:
    faces = np.zeros((6, 8, 8, 3), dtype=np.float32)
    faces[:, :, :, 0] = np.arange(1, 7)[:, None, None]
    look = equirectangular(faces, 16, 32)[..., 0]
    towards = directions(16, 32)
    inside = np.abs(towards).max(axis=-1) > 0.8  # away from the edges of the cube
    axis = np.abs(towards).argmax(axis=-1)
    sign = np.take_along_axis(towards, axis[..., None], axis=-1)[..., 0] < 0
    assert np.allclose(look[inside], (2 * axis + sign + 1)[inside], rtol=1e-5)


def test_locate_inverts_direction() -> None:
    n = 5
    face, row, column = (grid.ravel() for grid in np.indices((6, n, n)))
    s, t = (2 * (column + 0.5) / n - 1), (2 * (row + 0.5) / n - 1)
    found = _locate(_direction(face, s, t), n)
    assert all(np.array_equal(a, b) for a, b in zip(found, (face, row, column), strict=True))


@pytest.mark.parametrize(("face", "row", "column"), [(4, 32, 32), (2, 31, 32), (1, 0, 0), (3, 63, 5), (5, 60, 20)])
def test_a_sun_arrives_whole_and_in_place(face: int, row: int, column: int) -> None:
    n = 64
    faces = np.full((6, n, n, 3), 0.5, dtype=np.float32)
    faces[face, row, column] = 40000.0
    s, t = np.array([2 * (column + 0.5) / n - 1]), np.array([2 * (row + 0.5) / n - 1])
    solid = (2 / n) ** 2 * (1 + s**2 + t**2) ** -1.5
    look = equirectangular(faces, 32, 64)
    weights = solid_angles(32, 64)[..., None]
    assert np.allclose((look * weights).sum(axis=(0, 1)), 0.5 * 4 * np.pi + 39999.5 * solid, rtol=2e-3)
    moment = ((look[..., :1] - 0.5) * weights * directions(32, 64)).sum(axis=(0, 1))
    assert moment @ _direction(np.array([face]), s, t)[0] / np.linalg.norm(moment) > np.cos(1.5 * np.pi / 32)


def test_the_mirrored_cube_is_the_mirrored_map() -> None:
    n = 64
    faces = np.ones((6, n, n, 3), dtype=np.float32)
    for lamp in [(1, 13, 5), (4, 8, 42), (5, 51, 23), (2, 6, 61), (0, 9, 39)]:
        faces[lamp] = 5000.0
    mirrored = faces[[1, 0, 2, 3, 4, 5], :, ::-1]  # x to -x: two faces change places, all change their sides
    assert np.allclose(equirectangular(mirrored, 32, 64), equirectangular(faces, 32, 64)[:, ::-1], rtol=1e-5)


def test_shipped_skyboxes_keep_their_power() -> None:
    import importlib.util

    folder = Path(importlib.util.find_spec("open3d").origin).parent / "resources"
    assert {path.name.removesuffix("_skybox.ktx") for path in folder.glob("*_skybox.ktx")} == set(SKYBOXES)
    grid = (np.arange(256) + 0.5) / 128 - 1
    s, t = np.meshgrid(grid, grid)
    solid = (2 / 256) ** 2 * (1 + s**2 + t**2) ** -1.5
    for name in ("crossroads", "nightlights"):
        faces = read_ktx(folder / f"{name}_skybox.ktx").astype(np.float64)
        exact = (faces * solid[..., None]).sum(axis=(0, 1, 2))
        environment = skybox(name, 32, 64)
        assert environment.name == name
        total = (environment.radiance * solid_angles(32, 64)[..., None]).sum(axis=(0, 1))
        assert np.allclose(total, exact, rtol=0.01)  # what is promised is 2 %
    # up is up: the sky over the meadow is brighter than the ground
    radiance = skybox("brightday", 8, 16).radiance[..., 2]
    assert radiance[0].mean() > 2 * radiance[-1].mean()


def test_unknown_skybox_gets_a_hint() -> None:
    with pytest.raises(InputError, match="did you mean 'park'"):
        skybox("parc", 4, 8)
