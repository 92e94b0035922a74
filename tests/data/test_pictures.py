"""Reading pictures of every kind: what is linear, what is decoded, what alpha does, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from handbench.data.exr import write_exr
from handbench.data.pictures import Stated, folder_of, matched, read_mask, read_picture
from handbench.errors import InputError

CODES = np.arange(2 * 3 * 4, dtype=np.uint8).reshape(2, 3, 4) * 10
LINEAR = np.where(CODES / 255 <= 0.04045, CODES / 255 / 12.92, ((CODES / 255 + 0.055) / 1.055) ** 2.4)


def exr(path: Path, names: str, values: np.ndarray) -> Path:
    write_exr(path, {name: values[..., i].astype(np.float32) for i, name in enumerate(names)})
    return path


def test_exr_is_linear_and_premultiplied(tmp_path: Path) -> None:
    values = np.float32(CODES) / 100 * np.float32([1, 1, 1, 0.4])  # colours beyond 1
    found = read_picture(exr(tmp_path / "a.exr", "RGBA", values))
    np.testing.assert_array_equal(found.image, values[..., :3])
    np.testing.assert_array_equal(found.alpha, values[..., 3])
    assert read_picture(exr(tmp_path / "b.exr", "RGB", values)).alpha is None


@pytest.mark.parametrize("channels", [3, 4])
def test_png_of_8_bits_is_srgb_and_its_alpha_is_straight(tmp_path: Path, channels: int) -> None:
    Image.fromarray(CODES[..., :channels]).save(tmp_path / "a.png")
    found = read_picture(tmp_path / "a.png")
    alpha = CODES[..., 3:] / 255 if channels == 4 else 1
    np.testing.assert_allclose(found.image, LINEAR[..., :3] * alpha, atol=1e-6)
    assert (found.alpha is None) == (channels == 3) and found.image.dtype == np.float32
    as_is = read_picture(tmp_path / "a.png", Stated("linear"))
    np.testing.assert_allclose(as_is.image, CODES[..., :3] / 255 * alpha, atol=1e-6)


def test_png_of_16_bits_keeps_its_lower_byte(tmp_path: Path) -> None:
    import mitsuba

    values = np.linspace(0, 65535, 60).astype(np.uint16).reshape(4, 5, 3)
    mitsuba.Bitmap(values).write(str(tmp_path / "a.png"))
    np.testing.assert_allclose(read_picture(tmp_path / "a.png", Stated("linear")).image, values / 65535, atol=1e-7)


def test_a_palette_is_looked_up_and_jpeg_is_srgb(tmp_path: Path) -> None:
    grey = np.full((16, 16, 3), 188, np.uint8)
    Image.fromarray(grey).quantize(4).save(tmp_path / "a.png")
    Image.fromarray(grey).save(tmp_path / "b.jpg", quality=95)
    for name in ("a.png", "b.jpg"):
        np.testing.assert_allclose(read_picture(tmp_path / name).image, 0.5029, atol=0.01)


def test_numpy_floats_are_linear_and_integers_must_say_what_they_are(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", LINEAR)
    np.testing.assert_allclose(read_picture(tmp_path / "a.npy").image, LINEAR[..., :3], atol=1e-7)
    np.save(tmp_path / "b.npy", CODES[..., :3])
    with pytest.raises(InputError, match=r"holds integers \(uint8\) whose encoding is unknown; say linear or srgb"):
        read_picture(tmp_path / "b.npy")
    np.testing.assert_allclose(read_picture(tmp_path / "b.npy", Stated("srgb")).image, LINEAR[..., :3], atol=1e-6)
    np.save(tmp_path / "c.npy", CODES[..., :3].astype(np.uint16) * 257)
    np.testing.assert_allclose(read_picture(tmp_path / "c.npy", Stated("srgb")).image, LINEAR[..., :3], atol=1e-6)


def test_masks(tmp_path: Path) -> None:
    ramp = np.linspace(0, 255, 12).astype(np.uint8).reshape(3, 4)
    opaque = np.full_like(ramp, 255)
    Image.fromarray(ramp).save(tmp_path / "grey.png")
    Image.fromarray(np.stack([ramp] * 3, -1)).save(tmp_path / "rgb.png")
    Image.fromarray(np.stack([ramp] * 3 + [opaque], -1)).save(tmp_path / "opaque.png")
    Image.fromarray(np.stack([opaque] * 3 + [ramp], -1)).save(tmp_path / "alpha.png")
    exr(tmp_path / "one.exr", "Y", ramp[..., None] / 255)
    exr(tmp_path / "a.exr", "RGBA", np.stack([opaque] * 3 + [ramp], -1) / 255)
    np.save(tmp_path / "float.npy", ramp / 255)
    for path in tmp_path.iterdir():
        np.testing.assert_allclose(read_mask(path), ramp / 255, atol=1e-6, err_msg=path.name)
    np.save(tmp_path / "bool.npy", ramp > 99)
    np.testing.assert_array_equal(read_mask(tmp_path / "bool.npy"), ramp > 99)


def test_what_is_refused(tmp_path: Path) -> None:
    (tmp_path / "text.png").write_text("no picture")
    (tmp_path / "text.exr").write_text("no picture")
    (tmp_path / "text.npy").write_text("no picture")
    (tmp_path / "a.tiff").write_text("no picture")
    np.save(tmp_path / "nan.npy", np.full((2, 2, 3), np.nan))
    np.save(tmp_path / "long.npy", np.zeros((2, 2, 3), np.int64))
    np.save(tmp_path / "none.npy", np.zeros((0, 2, 3)))
    np.save(tmp_path / "flat.npy", np.zeros((2, 2)))
    np.save(tmp_path / "bright.npy", np.full((2, 2, 3), 2.0))
    np.save(tmp_path / "object.npy", np.array([{}], dtype=object), allow_pickle=True)
    for name, message in {
        "absent.png": "does not exist",
        "text.png": "damaged or no picture",
        "text.exr": "damaged or no EXR file",
        "text.npy": "damaged or no numpy file",
        "object.npy": "damaged or no numpy file",
        "a.tiff": "unknown type; expected a file ending in .exr, .png",
        "nan.npy": "holds 12 values that are NaN, infinite or beyond 32-bit floats",
        "long.npy": "holds int64; expected floating point, uint8 or uint16",
        "none.npy": r"is empty: its shape is \(0, 2, 3\)",
        "flat.npy": r"has shape \(2, 2\), expected \(H, W, 3\) or \(H, W, 4\)",
    }.items():
        with pytest.raises(InputError, match=message):
            read_picture(tmp_path / name)
    with pytest.raises(InputError, match="has values from 2 to 2; sRGB values are 0 to 1"):
        read_picture(tmp_path / "bright.npy", Stated("srgb"))
    with pytest.raises(InputError, match="has values from 2 to 2; expected 0 to 1"):
        read_mask(tmp_path / "bright.npy")
    np.save(tmp_path / "colours.npy", LINEAR[..., :3])
    with pytest.raises(InputError, match="has colours; give one channel"):
        read_mask(tmp_path / "colours.npy")


def test_folders_are_matched_by_name_without_suffix(tmp_path: Path) -> None:
    for name in ("p/b.npy", "p/a.npy", "t/a.exr", "t/b.png", "t/.hidden.png", "t/notes.txt", "empty/notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    (tmp_path / "t" / "c.png").symlink_to(tmp_path / "t" / "b.png")
    for hidden in ("p/.cache", "p/s01/dorsal"):
        (tmp_path / hidden).mkdir(parents=True)
        (tmp_path / hidden / "lamp.png").write_bytes(b"")
    assert list(folder_of(tmp_path / "p")) == ["a", "b", "s01/dorsal/lamp"], "hidden folders are left out"
    (tmp_path / "p/s01/dorsal/lamp.png").unlink()
    prediction, truth = folder_of(tmp_path / "p"), folder_of(tmp_path / "t")
    assert list(prediction) == ["a", "b"] and list(truth) == ["a", "b", "c"]
    with pytest.raises(InputError, match="the prediction lacks c; pictures of equal names are compared"):
        matched({"the prediction": prediction, "the truth": truth})
    assert matched({"the prediction": prediction, "the truth": dict(list(truth.items())[:2])}) == ["a", "b"]
    many = {f"x{i}": tmp_path for i in range(9)}
    with pytest.raises(InputError, match="b lacks x0, x1, x2, x3 and 5 more"):
        matched({"a": many, "b": {}})
    (tmp_path / "t" / "a.png").touch()
    with pytest.raises(InputError, match=r"has a\.exr and a\.png; keep one of them"):
        folder_of(tmp_path / "t")
    with pytest.raises(InputError, match="holds no pictures"):
        folder_of(tmp_path / "empty")
    with pytest.raises(InputError, match="does not exist"):
        folder_of(tmp_path / "absent")
