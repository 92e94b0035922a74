"""The border to the disk: files that appear whole or not at all, and files of others that are read with care.

`read_bytes`, `read_text` and `read_json` read regular files below a limit; `check_file` and `check_folder` look at a
target before the work; `whole` and `writing` write. Every failure is one sentence.
"""

from __future__ import annotations

import errno
import json
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from .errors import Absent, InputError, StorageError, shortened

JSON_LIMIT = 256 << 20  # bytes
DEPTH = 64  # tables and lists in one another
WIDEST = (-(2**63), 2**63 - 1)  # whole numbers that databases and other languages can hold
LONGEST_KEY = 1000  # characters of the name of a frame


def read_bytes(path: Path, limit: int, what: str = "file") -> bytes:
    """The content of a regular file of at most `limit` bytes; `what` names its kind in errors.

    Raises `Absent` if there is none, and `InputError` for anything that is no regular file (a pipe, a device, a
    folder, also behind a link), is larger, or may not be read. Never waits for a writer.
    """
    try:
        # without O_NONBLOCK a named pipe would wait for its writer
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0))
        try:
            found = os.fstat(descriptor)
            if not stat.S_ISREG(found.st_mode):
                raise InputError(f"{what} {path} is {_kind(found.st_mode)}; give a regular file")
            with os.fdopen(descriptor, "rb", closefd=False) as file:
                content = file.read(limit + 1) if found.st_size <= limit else b""
        finally:
            os.close(descriptor)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise Absent(f"{what} {path} does not exist; check its path") from error
    except (OSError, ValueError) as error:  # a name with a null byte is a ValueError
        if isinstance(error, InputError):
            raise
        why = getattr(error, "strerror", None) or error
        raise InputError(f"{what} {path} cannot be read ({why}); check its path and permissions") from error
    if max(len(content), found.st_size) > limit:
        size = max(len(content), found.st_size)
        raise InputError(f"{what} {path} has {size:,} bytes, more than the {limit:,} that such a file may have")
    return content


def read_text(path: Path, limit: int, what: str = "file") -> str:
    """The text of a UTF-8 file, with or without a byte order mark, under the rules of `read_bytes`."""
    try:
        return read_bytes(path, limit, what).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{what} {path} is no UTF-8 text (byte {error.start}); save it as UTF-8") from error


def read_json(path: Path, limit: int = JSON_LIMIT, what: str = "file") -> Any:
    """The value in a JSON file, under the rules of `read_bytes` and `check_value`."""
    text = read_text(path, limit, what)
    try:
        value = json.loads(text)
    except RecursionError as error:
        raise InputError(f"{what} {path} is nested deeper than {DEPTH} levels; it is no file of ours") from error
    except ValueError as error:  # of syntax, or a number with thousands of digits
        raise InputError(f"{what} {path} is no JSON: {_reason(error)}") from error
    check_value(value, f"{what} {path}")
    return value


def check_value(value: Any, owner: str) -> None:
    """Raises `InputError` unless a parsed value can be kept and shown: at most `DEPTH` levels, whole numbers of
    64 bits, texts without lone surrogates. `owner` begins the sentence."""
    level = [[value]]
    for _ in range(DEPTH + 1):
        inner: list[Any] = []
        for each in level:
            members = [*each, *each.values()] if isinstance(each, dict) else each
            kinds = set(map(type, members))  # a list of a thousand numbers is looked at at once
            if kinds <= _PLAIN:
                continue
            if str in kinds and (odd := next((m for m in members if type(m) is str and _halved(m)), None)) is not None:
                raise InputError(f"{owner}: {odd[:40]!a} holds half a character (a lone surrogate); remove it")
            if int in kinds and (wide := next((m for m in members if type(m) is int and _wide(m)), None)) is not None:
                raise InputError(f"{owner}: {shortened(wide)} does not fit into 64 bits; give a smaller number")
            if kinds & {dict, list}:
                inner.extend(m for m in members if isinstance(m, (dict, list)))
        if not inner:
            return
        level = inner
    raise InputError(f"{owner}: tables or lists are nested deeper than {DEPTH} levels; make it flat")


_PLAIN = {float, bool, type(None)}


def _halved(text: str) -> bool:
    return not text.isascii() and _SURROGATE.search(text) is not None


def _wide(number: int) -> bool:
    return not WIDEST[0] <= number <= WIDEST[1]


def check_file(path: Path, remedy: str = "choose another file with --out") -> None:
    """Raises `StorageError` unless a file can be written at `path`: nothing or a regular file is there, in a folder
    that is there and can be written. For verbs that work before they write."""
    with writing(path, remedy):
        if path.exists() and not path.is_file():
            raise StorageError(f"{path} is {_kind(path.stat().st_mode)} and is not replaced; {remedy}")
        _probe(path)


def check_folder(path: Path, remedy: str = "choose another folder with --out") -> None:
    """Raises `StorageError` unless files can be written below `path`, which need not be there yet."""
    check_name(path, remedy)
    with writing(path, remedy):
        there = path
        while not there.exists() and there != there.parent:
            if there.is_symlink():
                raise OSError(errno.ENOENT, "a link to nothing")
            there = there.parent
        if not there.is_dir():
            raise StorageError(f"{there} is {_kind(there.stat().st_mode)}, no folder; {remedy}")
        _probe(there / (path.name if there != path else "probe"))


def check_name(path: Path, remedy: str = "choose another folder with --out") -> None:
    """Raises `StorageError` for a folder whose name is no UTF-8: weights written there cannot be read again, as the
    library that reads them refuses such paths."""
    if _halved(str(path)):
        raise StorageError(f"{path} has a byte that is no UTF-8; {remedy}")


@contextmanager
def writing(path: Path, remedy: str = "choose another folder with --out") -> Iterator[None]:
    """Turn an `OSError` while writing `path` into one `StorageError` sentence; `remedy` is not for a full disk."""
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            text = f"the disk is full, {path} cannot be written; free some space and run again"
        else:
            text = f"{path} cannot be written ({error.strerror or error}); {remedy}"
        raise StorageError(text) from error


@contextmanager
def whole(path: Path, remedy: str = "free some space or choose another folder") -> Iterator[Path]:
    """A temporary path beside `path`, moved there once the block is through; nothing is left if it fails.

    What exists and is no regular file is never replaced. The content is on the disk before the name is.
    Raises `StorageError` for a full disk, a folder that is missing or one that cannot be written.
    """
    part = _part(path)
    try:
        with writing(path, remedy):
            if path.exists() and not path.is_file():
                raise StorageError(f"{path} is {_kind(path.stat().st_mode)} and is not replaced; {remedy}")
            yield part
            with part.open("rb") as file:
                os.fsync(file.fileno())
            part.replace(path)
    finally:
        with suppress(OSError):
            part.unlink()


def _part(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}.part")


def _probe(path: Path) -> None:
    """Write an empty file beside `path` and remove it: permissions alone do not say whether that is possible."""
    part = _part(path)
    part.touch()
    part.unlink()


_SURROGATE = re.compile("[\ud800-\udfff]")
_KINDS = (
    (stat.S_ISREG, "a file"),
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def _kind(mode: int) -> str:
    return next((name for fits, name in _KINDS if fits(mode)), "no regular file")


def _reason(error: ValueError) -> str:
    """Why JSON could not be read; Python's advice about digits is none for a reader of ours."""
    return "a number has thousands of digits" if "digits" in str(error) else str(error)
