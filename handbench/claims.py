"""Claims: what one process is at work on, so that others do not do it too.

A claim is a file that its process has locked. The system takes the lock away when the process ends, however it
ends, so a claim is never stale; what a killed process leaves is a file without a lock. On a file system without
locks everybody's claim is granted: work may be done twice, and comes out the same.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


@contextmanager
def claim(path: Path) -> Iterator[bool]:
    """Whether this process has the claim `path` inside the block; the folder is made, the file goes with the claim."""
    descriptor = _locked(path)
    try:
        yield descriptor is not None
    finally:
        if descriptor is not None:
            with suppress(OSError):
                path.unlink()  # while it is locked: whoever opened it meanwhile sees that it is gone
            os.close(descriptor)


def holder(path: Path) -> str | None:
    """Machine and process of whoever has a claim, for people; None if nobody has it."""
    try:
        return path.read_text(encoding="utf-8").strip() or None
    except OSError:
        return None


def _locked(path: Path) -> int | None:
    """A descriptor of the file, with its lock, or None if another process has that."""
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except FileNotFoundError:  # its last user removed the folder between our two looks
            continue
        try:
            if fcntl is not None:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            return None
        except OSError:  # a file system without locks
            pass
        if _still(path, descriptor):
            with suppress(OSError):  # a note for people
                os.truncate(descriptor, 0)
                os.write(descriptor, f"{socket.gethostname()} process {os.getpid()}\n".encode())
            return descriptor
        os.close(descriptor)  # its last owner removed it between our opening and our locking


def _still(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False
