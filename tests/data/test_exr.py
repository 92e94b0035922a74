"""EXR files: what is written is read, damage is named, nothing is half-written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from handbench.data.exr import read_exr, rgb, stack, write_exr
from handbench.errors import InputError, StorageError


def test_round_trip_keeps_names_and_values(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    image = rng.random((5, 7, 3)).astype(np.float16)
    depth = rng.random((5, 7)).astype(np.float32)
    path = tmp_path / "picture.exr"
    write_exr(path, {**rgb(image), "depth.Z": depth})
    write_exr(str(path), {**rgb(image), "depth.Z": depth})  # a path as text will do
    channels = read_exr(path)
    assert np.array_equal(stack(channels, ("R", "G", "B"), path), image.astype(np.float32))
    assert np.array_equal(channels["depth.Z"], depth)
    assert [p.name for p in tmp_path.iterdir()] == ["picture.exr"]


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.95])
def test_a_truncated_file_is_refused_without_noise(
    tmp_path: Path, share: float, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cut.exr"
    write_exr(path, rgb(np.random.default_rng(1).random((64, 64, 3))))
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError, match=r"cut\.exr is damaged"):
        read_exr(path)
    assert capfd.readouterr().err == ""


def test_missing_files_and_channels_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone\.exr does not exist"):
        read_exr(tmp_path / "gone.exr")
    path = tmp_path / "grey.exr"
    write_exr(path, {"Y": np.zeros((2, 2), np.float32)})
    with pytest.raises(InputError, match="no channel 'R'; it has Y"):
        stack(read_exr(path), ("R", "G", "B"), path)


def test_nan_pixels_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "nan.exr"
    write_exr(path, {"R": np.array([[np.nan, 1.0]], np.float32)})
    with pytest.raises(
        InputError, match=r"channel 'R' has 1 NaN or infinite pixels, the first \(NaN\) in row 0, column 0"
    ):
        read_exr(path)


def test_a_folder_that_is_none_is_one_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(StorageError, match="cannot be written"):
        write_exr(blocked / "picture.exr", rgb(np.zeros((2, 2, 3))))
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_shapes_and_types_are_checked(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="share one"):
        write_exr(tmp_path / "x.exr", {"R": np.zeros((2, 2), np.float32), "G": np.zeros((2, 3), np.float32)})
    with pytest.raises(InputError, match="float64"):
        write_exr(tmp_path / "x.exr", {"R": np.zeros((2, 2))})
