"""Files that appear whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import StorageError


@contextmanager
def whole(path: Path, remedy: str = "free some space or choose another folder") -> Iterator[Path]:
    """A temporary path beside `path`, moved there once the block is through; nothing is left if it fails.

    Raises `StorageError` for a full disk, a folder that is missing or one that cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        part.replace(path)
    except OSError as error:
        raise StorageError(f"{path} cannot be written ({error}); {remedy}") from error
    finally:
        with suppress(OSError):
            part.unlink()
