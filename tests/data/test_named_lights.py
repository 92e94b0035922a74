"""Lights by name: the one-texel test of every kind of file, and what a text may say."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from handbench.data.exr import rgb, write_exr
from handbench.data.lights import NamedLight
from handbench.errors import InputError
from handbench.light.environment import to_directional

TOWARDS = {"+x": (16, 1 / 4), "-x": (16, 3 / 4), "+z": (16, 1 / 2), "-z": (16, 0), "+y": (0, 1 / 8), "-y": (31, 1 / 8)}
FACES = ("+x", "-x", "+y", "-y", "+z", "-z")


def axis(name: str) -> np.ndarray:
    return np.eye(3)["xyz".index(name[1])] * (1 if name[0] == "+" else -1)


def strongest(text: str) -> np.ndarray:
    where, power = to_directional(NamedLight.parse(text).read())
    return where[power.sum(axis=1).argmax()]


def one_texel(name: str) -> np.ndarray:
    row, part = TOWARDS[name]
    sun = np.zeros((32, 64, 3), np.float32)
    sun[row, int(part * 64)] = 512.0
    return sun


def ktx(pictures: np.ndarray, internal: int) -> bytes:
    """Pictures (F, H, W, C), lines padded to four bytes, as a KTX 1 file."""
    faces, height, width = pictures.shape[:3]
    header = struct.pack("<13I", 0x04030201, 0x140B, 2, 0x1907, internal, 0x1907, width, height, 0, 0, faces, 1, 0)
    line = pictures.reshape(faces, height, -1).view(np.uint8)
    padded = np.pad(line, ((0, 0), (0, 0), (0, -line.shape[2] % 4)))
    return b"\xabKTX 11\xbb\r\n\x1a\n" + header + struct.pack("<I", padded[0].size) + padded.tobytes()


@pytest.mark.parametrize("name", TOWARDS)
@pytest.mark.parametrize("suffix", [".exr", ".hdr", ".ktx"])
def test_one_texel_lights_from_where_it_stands(tmp_path: Path, name: str, suffix: str) -> None:
    path = tmp_path / f"sun{suffix}"
    sun = one_texel(name)
    if suffix == ".exr":
        write_exr(path, rgb(sun, dtype=np.float32))
    elif suffix == ".ktx":
        path.write_bytes(ktx(sun[None].astype("<f4"), 0x8815))
    else:
        codes = np.zeros((32, 64, 4), np.uint8)
        codes[sun[..., 0] > 0] = (128, 128, 128, 138)  # 128 * 2^(138 - 136)
        path.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 32 +X 64\n" + codes.tobytes())
    assert strongest(str(path)) @ axis(name) > 0.97  # a texel of the reduced map is 11 degrees wide


@pytest.mark.parametrize("face", range(6))
def test_one_texel_of_a_cube_lights_from_its_face(tmp_path: Path, face: int) -> None:
    cube = np.zeros((6, 9, 9, 3), "<f2")  # lines of 54 bytes, so padded
    cube[face, 4, 4] = 100.0
    (tmp_path / "cube.ktx").write_bytes(ktx(cube, 0x881B))
    assert strongest(f"{tmp_path / 'cube.ktx'}") @ axis(FACES[face]) > 0.97


def test_turned_right_handed_and_exposed(tmp_path: Path) -> None:
    path = tmp_path / "sun.exr"
    write_exr(path, rgb(one_texel("+z"), dtype=np.float32))
    assert strongest(f"{path}:rotate=90") @ axis("+x") > 0.97
    assert strongest(f"{path}:exposure=1,rotate=-90") @ axis("-x") > 0.97
    plain, brighter = (NamedLight.parse(f"{path}{more}").read().radiance.sum() for more in ("", ":exposure=2"))
    assert brighter == pytest.approx(4 * plain)


def test_names_and_options() -> None:
    assert NamedLight.parse("hall:rotate=90,exposure=-1.5") == NamedLight("hall", 90.0, -1.5)
    assert NamedLight.parse("hall:clip").clip
    assert NamedLight.parse("C:/maps/studio.exr").source == "C:/maps/studio.exr"
    assert NamedLight.parse("a/studio.exr:rotate=90").label == "studio, rotate 90"
    assert NamedLight.parse("hall").read().name == "hall"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hall:rotat=90", "did you mean 'rotate'"),
        ("hall:rotate=north", "rotate is 'north'; give a number"),
        ("hall:exposure=900", "900 stops; give -30 to 30"),
        ("hall:clip=1", "clip takes no value"),
        ("hal", "did you mean 'hall'"),
        (":rotate=3", "names no map"),
        ("none.exr", "none.exr does not exist"),
    ],
)
def test_bad_names_are_told(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        NamedLight.parse(text).read()


def test_a_sun_beyond_half_floats_is_told(tmp_path: Path) -> None:
    sky = np.ones((16, 32, 3), np.float16)
    sky[3, 4] = 65504.0
    write_exr(tmp_path / "cut.exr", rgb(sky))
    remarks: list[str] = []
    NamedLight.parse(str(tmp_path / "cut.exr")).read(remarks.append)
    assert len(remarks) == 1 and "1 texels are at 65504 or above" in remarks[0]
    sky[3, 4] = np.inf
    write_exr(tmp_path / "sun.exr", rgb(sky))
    with pytest.raises(InputError, match=r"brighter than a half float.*:clip"):
        NamedLight.parse(str(tmp_path / "sun.exr")).read()
    assert NamedLight.parse(f"{tmp_path / 'sun.exr'}:clip").read().radiance.max() == 65504.0
    write_exr(tmp_path / "black.exr", rgb(0 * np.ones((16, 32, 3), np.float32)))
    NamedLight.parse(str(tmp_path / "black.exr")).read(remarks.append)
    assert "black everywhere" in remarks[-1]


def test_large_cubes_are_refused_before_memory_is_taken(tmp_path: Path) -> None:
    header = ktx(np.zeros((6, 2, 2, 3), "<f4"), 0x8815)
    grown = header[:36] + struct.pack("<2I", 2048, 2048) + header[44:]
    (tmp_path / "big.ktx").write_bytes(grown)
    with pytest.raises(InputError, match="2048 texels a side"):
        NamedLight.parse(str(tmp_path / "big.ktx")).read()
