"""Files that appear whole or not at all, and one sentence for those that cannot be written."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import StorageError


@contextmanager
def writing(path: Path, remedy: str = "choose another folder with --out") -> Iterator[None]:
    """Turn an `OSError` while writing `path` into one `StorageError` sentence; `remedy` is not for a full disk."""
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            text = f"the disk is full, {path} cannot be written; free some space and run again, what is done is kept"
        else:
            text = f"{path} cannot be written ({error.strerror or error}); {remedy}"
        raise StorageError(text) from error


@contextmanager
def whole(path: Path, remedy: str = "free some space or choose another folder") -> Iterator[Path]:
    """A temporary path beside `path`, moved there once the block is through; nothing is left if it fails.

    Raises `StorageError` for a full disk, a folder that is missing or one that cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with writing(path, remedy):
            yield part
            part.replace(path)
    finally:
        with suppress(OSError):
            part.unlink()
