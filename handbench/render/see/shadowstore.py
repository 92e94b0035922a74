"""Shadows kept on disk: packed rows by content hash, in a folder of bounded size.

    with kept_on_disk(default_folder(), 1 << 30):
        PosedSurface(mesh, 128).visibility(lights)       # traced once, by whichever process comes first

It is only a cache: a folder that cannot be written, a full disk or a damaged file cost time and nothing else.
"""

from __future__ import annotations

import hashlib
import os
import time
import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

import numpy as np

from ...cache import cache_folder
from ...files import whole
from ...scene import Array

_SUFFIX = ".shadows"
_MERGE = 16
"""Files of one surface before they become one, unless they are large: many small ones are slow to read."""

_LARGE = 32 << 20
_OVERHEAD = 1024  # bytes of a file besides its content
_HOUR = 3600.0


class ShadowStore:
    """Rows of bytes by surface and light: files `<surface>-<random>.shadows` in a folder, at most `limit` bytes.

    A file holds some lights of one surface and appears whole, so processes may share a folder. Beyond the limit the
    files that were not read for longest go.
    """

    def __init__(self, folder: Path, limit: int) -> None:
        self.folder, self.limit = Path(folder), limit
        self._latest: tuple[str, dict[bytes, Array]] = ("", {})  # the surface read or written last
        self._room = 0  # bytes that may be written before the folder is looked through again

    def read(self, surface: str, width: int) -> Mapping[bytes, Array]:
        """What is known of a surface: rows (width,) uint8 by light."""
        latest, rows = self._latest
        if latest != surface:
            rows = {}
            for path in self._files(surface):
                rows.update(_read(path, width))
            self._latest = (surface, rows)
        return rows

    def write(self, surface: str, rows: Mapping[bytes, Array]) -> None:
        """Keep rows (width,) uint8 of a surface; the names of lights are all of one length, as are the rows."""
        width = len(next(iter(rows.values())))
        self._latest = (surface, {**self.read(surface, width), **rows})
        with suppress(OSError):  # StorageError is one
            self.folder.mkdir(parents=True, exist_ok=True)
            small = [path for path in self._files(surface) if path.stat().st_size < _LARGE]
            merged = small if len(small) >= _MERGE else []
            content = dict(rows)
            for path in merged:
                content.update(_read(path, width))
            size = sum(len(light) + width for light in content) + _OVERHEAD
            if size > self._room:
                self._room = self._make_room(size)
            if size > self._room:
                return
            self._room -= size
            with whole(self.folder / f"{surface}-{uuid.uuid4().hex}{_SUFFIX}") as part, part.open("wb") as file:
                lights = np.frombuffer(b"".join(content), dtype=np.uint8).reshape(len(content), -1)
                np.savez(file, lights=lights, rows=np.stack(list(content.values())))
            for path in merged:
                _removed(path)

    def _files(self, surface: str) -> list[Path]:
        with suppress(OSError):
            return list(self.folder.glob(f"{surface}-*{_SUFFIX}"))
        return []

    def _make_room(self, size: int) -> int:
        """Remove what was not read for longest; the bytes that may be written before the next look at the folder."""
        wanted = max(size, self.limit // 20)
        found = []
        for path in self.folder.iterdir():
            with suppress(OSError):
                status = path.stat()
                if path.name.endswith(_SUFFIX):
                    found.append((status.st_mtime_ns, status.st_size, path))
                elif _abandoned(path, status.st_mtime):
                    _removed(path)
        total = sum(length for _, length, _ in found)
        for _, length, path in sorted(found):
            if total + wanted <= self.limit:
                break
            total -= length * _removed(path)
        return wanted if total + wanted <= self.limit else 0


def _read(path: Path, width: int) -> dict[bytes, Array]:
    """The rows of a file; none if it is damaged, and then it goes."""
    try:
        with np.load(path, allow_pickle=False) as held:  # checks the sums
            lights, rows = held["lights"], held["rows"]
        if lights.dtype == rows.dtype == np.uint8 and rows.shape == (len(lights), width):
            with suppress(OSError):
                os.utime(path)  # read just now: it stays
            return {light.tobytes(): row for light, row in zip(lights, rows, strict=True)}
    except FileNotFoundError:  # another process merged or removed it
        return {}
    except Exception:  # whatever reading a damaged file raises
        pass
    _removed(path)
    return {}


def _abandoned(path: Path, written: float) -> bool:
    """Whether a file is what a killed process left behind."""
    return path.name.endswith(".part") and _SUFFIX in path.name and time.time() - written > _HOUR


def _removed(path: Path) -> bool:
    try:
        path.unlink()
    except OSError:
        return False
    return True


def surface_key(arrays: Iterable[Array], *parameters: object) -> str:
    """A digest of a surface: arrays with their shapes and types, and the parameters of what is kept of it."""
    digest = hashlib.blake2b(repr(parameters).encode(), digest_size=16)
    for array in arrays:
        digest.update(repr((array.shape, array.dtype.str)).encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def default_folder() -> Path:
    """`shadows` beside the generated captures: in $HANDBENCH_DATA or the user's cache."""
    return cache_folder() / "shadows"


_store: ContextVar[ShadowStore | None] = ContextVar("shadow store", default=None)


def shadow_store() -> ShadowStore | None:
    """The store that is in use here, if any."""
    return _store.get()


@contextmanager
def kept_on_disk(folder: Path, limit: int) -> Iterator[None]:
    """Keep shadows in a folder of at most `limit` bytes, and use those there, inside the block."""
    before = _store.set(ShadowStore(folder, limit))
    try:
        yield
    finally:
        _store.reset(before)
