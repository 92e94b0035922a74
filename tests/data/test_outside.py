"""Files from outside: each states something that a careless reader takes for something else."""

from __future__ import annotations

import io
import random
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image, ImageCms

from handbench.data.arrays import read_arrays
from handbench.data.environments import read_environment as read
from handbench.data.pictures import Stated, read_mask, read_picture
from handbench.data.picturesize import has_alpha, picture_size
from handbench.data.predictions.picture import read_picture as read_prediction
from handbench.data.radiance import read_radiance
from handbench.errors import InputError
from handbench.scene import Camera

RNG = np.random.default_rng(0)
GREY = {name: np.full((6, 8), 0.25, np.float32) for name in "RGBA"}
CODES = RNG.integers(0, 256, (6, 8, 3), np.uint8)


def exr(path: Path, channels: dict | None = None, **header: object) -> Path:
    # the binding puts objects of its own into the dictionary
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, dict(channels or GREY)).write(str(path))
    return path


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(path: Path, *chunks: bytes, codes: np.ndarray = CODES, size: tuple[int, int] | None = None) -> Path:
    """A PNG of 8 or 16 bits with chunks before its pixels; `size` (width, height) may lie."""
    height, width, channels = codes.shape
    kind, bits = {1: 0, 2: 4, 3: 2, 4: 6}[channels], 8 * codes.itemsize
    header = struct.pack(">IIBBBBB", *(size or (width, height)), bits, kind, 0, 0, 0)
    lines = b"".join(b"\0" + line.astype(f">u{codes.itemsize}").tobytes() for line in codes)
    body = chunk(b"IHDR", header) + b"".join(chunks) + chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    return path


def hdr(path: Path, lines: bytes, *header: str, size: str = "-Y 4 +X 8") -> Path:
    path.write_bytes("\n".join(("#?RADIANCE", "FORMAT=32-bit_rle_rgbe", *header, "", size, "")).encode() + lines)
    return path


def gama(value: float) -> bytes:
    return chunk(b"gAMA", struct.pack(">I", round(value * 1e5)))


def profile(kind: str) -> bytes:
    made = ImageCms.createProfile(kind) if kind == "sRGB" else ImageCms.createProfile("LAB")
    return chunk(b"iCCP", b"x\0\0" + zlib.compress(ImageCms.ImageCmsProfile(made).tobytes()))


def npy(path: Path, shape: tuple[int, ...]) -> Path:
    """A header that announces more than there is."""
    held = io.BytesIO()
    np.lib.format.write_array_header_1_0(held, {"descr": "<f4", "fortran_order": False, "shape": shape})
    path.write_bytes(held.getvalue() + b"\0" * 64)
    return path


AP0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
FLAT = {name: np.full((6, 8), 7, np.uint32) for name in "RGBA"}
FAR = ((0, 0), (19999, 19999))

REFUSED: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "primaries": ("a.exr", lambda p: exr(p, chromaticities=AP0), r"states the primaries ACES \(AP0\)"),
    "interop": ("a.exr", lambda p: exr(p, colorInteropID="lin_ap1_scene"), "states the primaries 'lin_ap1_scene'"),
    "integers": ("a.exr", lambda p: exr(p, FLAT), r"channel 'R' holds whole numbers \(uint32\)"),
    "window": ("a.exr", lambda p: exr(p, displayWindow=FAR), "is 20000x20000, more than 67108864 pixels"),
    "many": ("a.exr", lambda p: exr(p, {f"c{i}": GREY["R"] for i in range(9)}), "no channels R, G, B; it has c0, c1"),
    "png as exr": ("a.exr", png, r"is a PNG named \.exr"),
    "zip as npy": ("a.npy", lambda p: np.savez(p.open("wb"), a=1), r"is a zip archive \(\.npz\) named \.npy"),
    "exr as png": ("a.png", exr, r"is an EXR named \.png"),
    "nothing": ("a.png", lambda p: p.touch(), "the file is empty"),
    "gamma": ("a.png", lambda p: png(p, gama(0.7)), r"states the gamma 0\.7 \(gAMA\)"),
    "cHRM": ("a.png", lambda p: png(p, chunk(b"cHRM", struct.pack(">8I", *range(8)))), r"states the primaries.*cHRM"),
    "cICP": ("a.png", lambda p: png(p, chunk(b"cICP", b"\x09\x10\0\1")), r"states the video colours \[9, 16, 0, 1\]"),
    "narrow": ("a.png", lambda p: png(p, chunk(b"cICP", b"\1\x0d\0\0")), r"states the video colours \[1, 13, 0, 0\]"),
    "beyond": (
        "a.npy",
        lambda p: np.save(p, np.full((2, 2, 3), 1e39)),
        "12 values that are NaN, infinite or beyond 32-bit",
    ),
    "lab": ("a.png", lambda p: png(p, profile("lab")), "has the colour profile .* not sRGB"),
    "broken profile": ("a.png", lambda p: png(p, chunk(b"iCCP", b"x\0\0" + zlib.compress(b"no"))), "cannot be read"),
    "bomb": ("a.png", lambda p: png(p, size=(30000, 30000)), "is 30000x30000, more than 67108864 pixels"),
    "large": ("a.png", lambda p: png(p, size=(9000, 9000)), "is 9000x9000, more than 67108864 pixels"),
    "cut": ("a.png", lambda p: p.write_bytes(png(p).read_bytes()[:-40]), "is damaged"),
    "cmyk": ("a.jpg", lambda p: Image.new("CMYK", (8, 8)).save(p), "is in CMYK"),
    "terabytes": ("a.npy", lambda p: npy(p, (1 << 20, 1 << 20, 3)), "is damaged or no numpy file|more than"),
    "negative": ("a.npy", lambda p: npy(p, (-3, 4, 3)), "is damaged"),
    "alpha": ("a.exr", lambda p: exr(p, {**GREY, "A": GREY["A"] + 1}), "has alpha from 1.25 to 1.25"),
    "folder": ("a.exr", lambda p: p.mkdir(), "is no regular file"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_certain_is_refused_by_name(case: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    name, make, told = REFUSED[case]
    make(tmp_path / name)
    with pytest.raises(InputError, match=told) as found:
        read_picture(tmp_path / name)
    assert str(tmp_path / name) in str(found.value) and "\n" not in str(found.value)
    assert capfd.readouterr() == ("", "")


def test_a_data_window_is_placed_into_the_display_window(tmp_path: Path) -> None:
    for left, top in ((2, 3), (-3, 1), (5, -4), (40, 0)):
        window = {"dataWindow": ((left, top), (left + 7, top + 5)), "displayWindow": ((0, 0), (9, 7))}
        image = read_picture(exr(tmp_path / "a.exr", **window)).image
        wanted = np.zeros((40, 80))
        wanted[16 + top : 22 + top, 20 + left : 28 + left] = 0.25
        np.testing.assert_array_equal(image[..., 0], wanted[16:24, 20:30])


def test_channels_that_do_not_count_decide_nothing(tmp_path: Path) -> None:
    bad = {"Z": np.full((6, 8), np.inf, np.float32), "id": FLAT["R"], "depth.V": np.full((6, 8), np.nan, np.float32)}
    assert (read_picture(exr(tmp_path / "a.exr", GREY | bad)).image == 0.25).all()
    lower = {name.lower(): pixels for name, pixels in GREY.items()}
    assert (read_picture(exr(tmp_path / "b.exr", lower | bad)).alpha == 0.25).all()


def test_a_subsampled_channel_is_one_sentence(tmp_path: Path) -> None:
    data = bytearray(exr(tmp_path / "a.exr").read_bytes())
    at = data.index(b"B\0\2\0\0\0") + 10  # after the name, the type and pLinear
    data[at : at + 8] = struct.pack("<2i", 2, 2)
    (tmp_path / "a.exr").write_bytes(data)
    with pytest.raises(InputError, match="channel 'B' is subsampled 2x2"):
        read_picture(tmp_path / "a.exr")


def test_an_alpha_a_rounding_outside_its_range_is_clamped(tmp_path: Path) -> None:
    alpha = np.full((6, 8), 1.0005, np.float32)
    alpha[0] = -1e-7
    found = read_picture(exr(tmp_path / "a.exr", {**GREY, "A": alpha})).alpha
    assert found is not None and found.min() == 0 and found.max() == 1


@pytest.mark.parametrize(
    ("chunks", "linear"),
    [
        ((), False),
        ((gama(1 / 2.2),), False),
        ((gama(1.0),), True),
        ((chunk(b"sRGB", b"\0"), gama(1.0)), False),
        ((profile("sRGB"),), False),
        ((chunk(b"cICP", b"\x01\x08\0\1"),), True),
    ],
)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_png_that_says_its_curve_is_believed(tmp_path: Path, chunks: tuple, linear: bool, dtype: type) -> None:
    codes = CODES.astype(dtype) * dtype(257 if dtype == np.uint16 else 1)
    image = read_picture(png(tmp_path / "a.png", *chunks, codes=codes)).image
    x = CODES / 255
    shown = x if linear else np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(image, shown, atol=2e-6)


def test_what_is_said_wins_over_what_a_png_states(tmp_path: Path) -> None:
    image = read_picture(png(tmp_path / "a.png", gama(0.7)), Stated("linear")).image
    np.testing.assert_allclose(image, CODES / 255, atol=1e-6)
    np.testing.assert_allclose(read_mask(png(tmp_path / "m.png", gama(0.7), codes=CODES[..., :1])), CODES[..., 0] / 255)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_transparent_colour_is_alpha(tmp_path: Path, dtype: type) -> None:
    codes = CODES.astype(dtype)
    key = chunk(b"tRNS", struct.pack(">3H", *codes[2, 3]))
    alpha = read_picture(png(tmp_path / "a.png", key, codes=codes)).alpha
    assert alpha is not None and np.argwhere(alpha == 0).tolist() == [[2, 3]] and alpha.max() == 1


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_pictures_are_turned_upright_as_exif_says(tmp_path: Path, orientation: int, suffix: str) -> None:
    from PIL import ImageOps

    image, path = Image.fromarray(np.kron(CODES, np.ones((8, 8, 1), np.uint8))), tmp_path / f"a.{suffix}"
    exif = Image.Exif()
    exif[0x0112] = orientation
    image.save(path, exif=exif)
    with Image.open(path) as stored:
        expected = np.asarray(ImageOps.exif_transpose(stored))
    np.testing.assert_allclose(read_picture(path, Stated("linear")).image, expected / 255, atol=1e-6)


def test_the_limit_is_the_one_that_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 10)  # Pillow refuses twice as many by itself
    path = png(tmp_path / "a.png")
    assert read_picture(path, Stated(max_pixels=48)).image.shape == (6, 8, 3)
    assert picture_size(path, 48) == (8, 6) and not has_alpha(path)
    for refused in (lambda: read_picture(path, Stated(max_pixels=47)), lambda: picture_size(path, 47)):
        with pytest.raises(InputError, match="is 8x6, more than 47 pixels"):
            refused()
    assert Image.MAX_IMAGE_PIXELS == 10


@pytest.mark.parametrize("kind", [">u2", "<u2", ">f4", ">f8"])
def test_numpy_files_of_either_byte_order(tmp_path: Path, kind: str) -> None:
    np.save(tmp_path / "a.npy", CODES.astype(kind))
    scale = 65535 if "u" in kind else 1
    np.testing.assert_allclose(read_picture(tmp_path / "a.npy", Stated("linear")).image, CODES / scale, rtol=1e-6)


def test_a_turned_prediction_has_the_size_that_it_shows(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(np.full((6, 8, 4), 255, np.uint8)).save(tmp_path / "a.png", exif=exif)
    upright, lying = (Camera("c", w, h, np.eye(3), np.eye(3, 4)) for w, h in ((6, 8), (8, 6)))
    assert read_prediction(tmp_path / "a.png", upright).image.shape == (8, 6, 3)
    with pytest.raises(InputError, match="is 6x8, its camera says 8x6"):
        read_prediction(tmp_path / "a.png", lying)


@pytest.mark.parametrize("largest", [1, 3])
def test_a_mask_of_small_codes_says_so(tmp_path: Path, largest: int) -> None:
    Image.fromarray(np.eye(8, dtype=np.uint8) * largest).save(tmp_path / "m.png")
    with pytest.raises(InputError, match=f"its greatest value is {largest} of 255, so no pixel is inside"):
        read_mask(tmp_path / "m.png")


RGBE = RNG.integers(2, 255, (4, 8, 4), np.uint8)
RGBE[..., 3] = RNG.integers(120, 136, (4, 8))
RGBE[1, 2:6] = RGBE[1, 1]
VALUES = np.ldexp(RGBE[..., :3].astype(np.float32), RGBE[..., 3:].astype(int) - 136)


def planes(rows: np.ndarray) -> bytes:
    """Lines in four planes of runs and literals."""
    text = b""
    for row in rows:
        text += b"\2\2" + struct.pack(">H", len(row))
        for plane in row.T:
            text += bytes([3, *plane[:3]]) + bytes([128 + 1, plane[3]]) + bytes([len(row) - 4, *plane[4:]])
    return text


def old_runs(rows: np.ndarray) -> bytes:
    text = b""
    for row in rows:
        x = 0
        while x < len(row):
            run = 1
            while x + run < len(row) and (row[x + run] == row[x]).all():
                run += 1
            text += row[x].tobytes() + (bytes([1, 1, 1, run - 1]) if run > 1 else b"")
            x += run
    return text


@pytest.mark.parametrize("coding", [lambda rows: rows.tobytes(), planes, old_runs])
def test_radiance_lines_of_every_coding(tmp_path: Path, coding: Callable[[np.ndarray], bytes]) -> None:
    np.testing.assert_array_equal(read(hdr(tmp_path / "a.hdr", coding(RGBE))).radiance, VALUES)


@pytest.mark.parametrize("axes", ["-Y +X", "+Y +X", "-Y -X", "+Y -X", "+X -Y", "-X -Y", "+X +Y", "-X +Y"])
def test_radiance_in_all_orientations(tmp_path: Path, axes: str) -> None:
    """A map whose texels are stored in that order: the first axis is that of the lines."""
    first, second = axes.split()
    upright = first[1] == "Y"
    stored = RGBE if upright else RGBE.swapaxes(0, 1)
    signs = {"-Y": 1, "+Y": -1, "+X": 1, "-X": -1}
    stored = np.ascontiguousarray(stored[:: signs[first], :: signs[second]])
    size = f"{first} {stored.shape[0]} {second} {stored.shape[1]}"
    np.testing.assert_array_equal(read(hdr(tmp_path / "a.hdr", stored.tobytes(), size=size)).radiance, VALUES)


def test_radiance_is_what_was_rendered_whatever_the_exposure(tmp_path: Path) -> None:
    header = ("EXPOSURE=2", "EXPOSURE = 4.0", "COLORCORR=1 2 0.5", "PRIMARIES=.64 .33 .3 .6 .15 .06 .3127 .329")
    radiance = read(hdr(tmp_path / "a.hdr", RGBE.tobytes(), *header)).radiance
    np.testing.assert_allclose(radiance, VALUES / (8 * np.array([1, 2, 0.5])), rtol=1e-6)


@pytest.mark.parametrize(
    ("header", "size", "told"),
    [
        (["FORMAT=32-bit_rle_xyze"], "-Y 4 +X 8", "format '32-bit_rle_xyze', which is not supported"),
        (["EXPOSURE=0"], "-Y 4 +X 8", "states the exposure"),
        (["EXPOSURE=nan"], "-Y 4 +X 8", "states the exposure"),
        (["EXPOSURE=bright"], "-Y 4 +X 8", "expected 1 numbers"),
        (["PRIMARIES=.7 .3 .3 .6 .15 .06 .33 .33"], "-Y 4 +X 8", "states the primaries"),
        ([], "-Y 4 +Y 8", "no header with a size"),
        ([], "-Y 40000 +X 80000", "is 80000x40000, more than"),
        ([], "-Y 0 +X 0", "is 0x0 pixels"),
        ([], "-Y 5 +X 8", "cut off"),
        ([], "-Y 4 +X 7", "is 7x4; an equirectangular map is twice"),
    ],
)
def test_what_is_wrong_with_a_radiance_header_is_told(tmp_path: Path, header: list[str], size: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        read(hdr(tmp_path / "a.hdr", RGBE.tobytes(), *header, size=size))


def test_suns_and_negative_texels_are_refused_with_advice_or_clipped(tmp_path: Path) -> None:
    sky = {name: np.full((4, 8), 0.5, np.float16) for name in "RGB"}
    sky["G"][1, 2] = np.inf
    with pytest.raises(InputError, match=r"1 infinite values.* 32-bit float, or take 65504 for them"):
        read(exr(tmp_path / "sun.exr", sky))
    assert read(tmp_path / "sun.exr", clip=True).radiance[1, 2].tolist() == [0.5, 65504, 0.5]
    sky["G"][1, 2] = -0.25
    with pytest.raises(InputError, match=r"1 negative values \(least -0.25\).*take 0 for them"):
        read(exr(tmp_path / "dark.exr", sky))
    assert read(tmp_path / "dark.exr", clip=True).radiance[1, 2].tolist() == [0.5, 0, 0.5]
    sky["G"][1, 2] = np.nan
    with pytest.raises(InputError, match="1 values that are NaN"):
        read(exr(tmp_path / "nan.exr", sky), clip=True)


def test_a_map_that_is_cropped_or_a_cube_is_refused(tmp_path: Path) -> None:
    sky = {name: np.full((4, 8), 0.5, np.float32) for name in "RGB"}
    crop = {"dataWindow": ((4, 2), (11, 5)), "displayWindow": ((0, 0), (15, 7))}
    with pytest.raises(InputError, match=r"is cropped: it stores 8x4 at \(4, 2\) of a picture of 16x8 at \(0, 0\)"):
        read(exr(tmp_path / "crop.exr", sky, **crop))
    with pytest.raises(InputError, match="says it is a cube map"):
        read(exr(tmp_path / "cube.exr", sky, envmap=OpenEXR.ENVMAP_CUBE))


@settings(max_examples=60)
@given(where=st.integers(0, 10_000), value=st.integers(0, 255))
def test_an_archive_of_arrays_with_any_byte_changed_is_whole_or_refused(where: int, value: int, archive: Path) -> None:
    data = bytearray((archive / "sound.npz").read_bytes())
    data[where % len(data)] = value
    (archive / "a.npz").write_bytes(data)
    try:
        found = read_arrays(archive / "a.npz")
    except InputError as error:
        assert "a.npz" in str(error) and "\n" not in str(error)
    else:
        assert all(np.array_equal(values, CODES) for values in found.values())


def test_an_archive_that_announces_too_much_is_refused(archive: Path) -> None:
    with pytest.raises(InputError, match=r"holds 544 bytes of arrays, more than the 500 that are read"):
        read_arrays(archive / "sound.npz", limit=500)


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("archive")
    np.savez_compressed(place / "sound.npz", codes=CODES, again=CODES)
    return place


FUZZED = {
    "a.exr": lambda p: exr(p, dict(GREY)),
    "a.png": png,
    "b.png": lambda p: png(p, gama(1.0), profile("sRGB"), codes=CODES.astype(np.uint16)),
    "a.jpg": lambda p: Image.fromarray(CODES).save(p),
    "a.npy": lambda p: np.save(p, CODES / np.float32(255)),
    "a.hdr": lambda p: hdr(p, planes(RGBE), "EXPOSURE=2"),
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, bytes]]:
    place = tmp_path_factory.mktemp("fuzz")
    for name, make in FUZZED.items():
        make(place / name)
    return {name: (place / name, (place / name).read_bytes()) for name in FUZZED}


@pytest.mark.parametrize("name", FUZZED)
@settings(max_examples=60)
@given(seed=st.integers(0, 2**32), changes=st.integers(1, 6), cut=st.booleans())
def test_damage_is_one_sentence_or_a_picture(name: str, seed: int, changes: int, cut: bool, sound: dict) -> None:
    """Bytes are changed and the end is cut off: what comes is finite and of its header's size, or an `InputError`."""
    path, data = sound[name]
    chance = random.Random(seed)
    spoiled = bytearray(data)
    for _ in range(changes):
        spoiled[chance.randrange(len(spoiled))] = chance.choice((0, 1, 127, 128, 255, chance.randrange(256)))
    path.write_bytes(spoiled[: chance.randrange(len(spoiled))] if cut else spoiled)
    stated = Stated(max_pixels=1 << 16)
    try:
        image = read_radiance(path, max_pixels=1 << 16) if name == "a.hdr" else read_picture(path, stated).image
    except InputError as error:
        assert "\n" not in str(error) and len(str(error)) < 700
    else:
        assert image.dtype == np.float32 and image.shape[0] * image.shape[1] <= 1 << 16 and np.isfinite(image).all()
