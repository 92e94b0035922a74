"""The border to the disk: what is read and what is written over."""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path

import pytest

from handbench import files
from handbench.errors import Absent, InputError, StorageError, shortened


def _fifo(folder: Path) -> Path:
    os.mkfifo(folder / "fifo")
    return folder / "fifo"


def _socket(folder: Path) -> Path:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(folder / "s"))
    return folder / "s"


def _link(folder: Path) -> Path:
    (folder / "link").symlink_to("/dev/zero")
    return folder / "link"


NOT_REGULAR = [_fifo, _link, lambda folder: folder, lambda folder: Path("/dev/zero"), _socket]


@pytest.mark.parametrize("make", NOT_REGULAR)
def test_only_regular_files_are_read(tmp_path, make):
    with pytest.raises(InputError, match=r"give a regular file|cannot be read"):
        files.read_bytes(make(tmp_path), 100)


@pytest.mark.parametrize("path", ["absent", "file/inside"])
def test_an_absent_file_has_an_error_of_its_own(tmp_path, path):
    (tmp_path / "file").touch()
    with pytest.raises(Absent, match="does not exist"):
        files.read_json(tmp_path / path)


def test_names_that_no_file_can_have(tmp_path):
    for name in ("a\0b", "x" * 5000, "\ud800"):
        with pytest.raises(InputError):
            files.read_bytes(tmp_path / name, 100)


def test_a_file_is_as_large_as_its_limit_allows(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"x" * 100)
    assert files.read_bytes(path, 100) == b"x" * 100
    path.write_bytes(b"x" * 101)
    with pytest.raises(InputError, match=r"manifest .* has 101 bytes, more than the 100"):
        files.read_bytes(path, 100, "manifest")
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(InputError, match="1,099,511,627,776 bytes"):
        files.read_bytes(path, 100)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "nested deeper"),
        ("[" * 70 + "]" * 70, "nested deeper"),
        ('{"a": ' * 70 + "1" + "}" * 70, "nested deeper"),
        ("9" * 5000, "a number has thousands of digits"),
        ('{"seed": 9223372036854775808}', "9223372036854775808 does not fit into 64 bits"),
        ('["\\ud800"]', "lone surrogate"),
        ('{"\\udfff": 1}', "lone surrogate"),
        ("{", "is no JSON"),
        ("", "is no JSON"),
    ],
)
def test_json_that_cannot_be_used_is_one_sentence(tmp_path, text, message):
    path = tmp_path / "a.json"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        files.read_json(path)
    assert len(str(caught.value)) < len(str(path)) + 200


def test_sound_json_is_read_whatever_marks_its_beginning(tmp_path):
    value = {"a": [1, 2.5, None, True, "ä🖐", {"b": -(2**63)}], "deep": 2**63 - 1}
    path = tmp_path / "a.json"
    for start in (b"", b"\xef\xbb\xbf"):
        path.write_bytes(start + json.dumps(value).encode())
        assert files.read_json(path) == value
    path.write_bytes(b'"\xff"')
    with pytest.raises(InputError, match="no UTF-8"):
        files.read_json(path)


@pytest.mark.parametrize("make", NOT_REGULAR)
def test_what_is_no_regular_file_is_never_replaced(tmp_path, make):
    path = make(tmp_path)
    before = os.lstat(path)
    with pytest.raises(StorageError, match="is not replaced"):
        files.check_file(path)
    with pytest.raises(StorageError, match="is not replaced"), files.whole(path) as part:
        part.write_text("x")
    assert os.lstat(path).st_ino == before.st_ino


def test_a_target_is_looked_at_before_the_work(tmp_path):
    files.check_file(tmp_path / "new.png")
    files.check_folder(tmp_path / "new" / "folder")
    files.check_folder(tmp_path)
    assert not list(tmp_path.iterdir())
    (tmp_path / "file").touch()
    (tmp_path / "dangling").symlink_to(tmp_path / "gone" / "x")
    for path in (tmp_path / "file", tmp_path / "file" / "below", tmp_path / "dangling", Path("/dev/null")):
        with pytest.raises(StorageError):
            files.check_folder(path)
    with pytest.raises(StorageError, match="No such file"):
        files.check_file(tmp_path / "absent" / "a.png")
    with pytest.raises(StorageError, match="has a byte that is no UTF-8; choose another folder"):
        files.check_folder(tmp_path / "\udcff")
    for target in (Path("/proc/a"), tmp_path / ("x" * 300)):
        with pytest.raises(StorageError):
            files.check_file(target)


def test_a_value_is_told_in_few_characters():
    for value in (10**5000, "x" * 10_000, [[]] * 10_000, {"a": 1}, 5):
        assert len(shortened(value)) < 90
    assert shortened(5) == "5"
