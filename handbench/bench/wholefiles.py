"""Files that are whole or absent: written under a temporary name that says which process writes it, then renamed."""

from __future__ import annotations

import hashlib
import os
import shutil
import socket
import uuid
from pathlib import Path


def link(source: Path, target: Path) -> None:
    """Make `target` the file that `source` is, or a copy of it where the disk has no such links."""
    part = part_of(target)
    try:
        try:
            os.link(source, part)
        except OSError:
            shutil.copyfile(source, part)
        part.replace(target)
    finally:
        remove(part)


def files_in(folder: Path) -> list[Path]:
    """The files of a folder and the folders in it, in order."""
    return sorted(path for path in folder.rglob("*") if path.is_file())


def sha256(path: Path) -> str:
    """Hex SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def put(path: Path, text: str) -> None:
    """Write a text and have it on the disk before anything else happens."""
    with path.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def part_of(path: Path) -> Path:
    """A name beside `path` that says which process writes it."""
    return path.with_name(f".{path.name}.{_host()}.{os.getpid()}.{uuid.uuid4().hex[:8]}.tmp")


def abandoned(part: Path) -> bool:
    """Whether a temporary file's process lived on this machine and is gone."""
    _, host, pid, *_ = part.name.rsplit(".", 4)
    return host == _host() and pid.isdigit() and not _lives(int(pid))


def _lives(pid: int) -> bool:
    """Whether a process of this machine can still write: one that has ended is there until somebody waits for it."""
    try:
        return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0] not in (b"Z", b"X")
    except OSError:  # it is gone, or this is not Linux
        pass
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def _host() -> str:
    return socket.gethostname().replace(".", "-")


def remove(path: Path) -> None:
    """Remove a file or a folder, if it is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
