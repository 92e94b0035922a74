"""Files in zip archives of others, read with care: looked at before memory is taken, nothing is written."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import Absent, InputError
from ...files import check_value, read_bytes
from ...scene import Array
from ..codes import opened_codes
from ..filekind import check_size

_LIMIT = 128 << 20  # bytes of one file, unpacked
_OPEN = 32  # archives


class Zips:
    """Reads members of archives; the last few stay open."""

    def __init__(self) -> None:
        self._archive = lru_cache(_OPEN)(_opened)

    def read(self, path: Path, member: str) -> bytes:
        """The content of a member. Raises `InputError` if it is missing, damaged or unpacks to more than 128 MB."""
        archive = self._archive(path)
        try:
            size = archive.getinfo(member).file_size
            if size > _LIMIT:
                raise InputError(f"{path}: {member} unpacks to {size:,} bytes, more than the {_LIMIT:,} that are read")
            with archive.open(member) as file:
                content = file.read(_LIMIT + 1)
        except KeyError as error:
            raise Absent(f"{path} has no {member}") from error
        except (zipfile.BadZipFile, OSError, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
            raise InputError(f"{path}: {member} is damaged ({error}); get it anew") from error
        if len(content) > _LIMIT:
            raise InputError(f"{path}: {member} unpacks to more than {_LIMIT:,} bytes; it is damaged")
        return content

    def picture(self, path: Path, member: str) -> Array:
        """The codes (H, W) or (H, W, C) of a PNG, JPEG or AVIF member."""
        return _decoded(self.read(path, member), path, member)

    def names(self, path: Path) -> list[str]:
        """The names of all members."""
        return self._archive(path).namelist()

    def first(self, path: Path, suffix: str) -> str:
        """The first member of a suffix. Raises `InputError` if there is none."""
        found = next((name for name in self.names(path) if name.endswith(suffix)), None)
        if found is None:
            raise InputError(f"{path} has no {suffix} files; get it anew")
        return found


class FileSet:
    """The files of a kind: in the folder of its name, or in the archive `KIND.zip` beside, below `KIND/` or not."""

    def __init__(self, zips: Zips, folder: Path, kind: str) -> None:
        self._zips, self._folder, self._archive = zips, folder / kind, folder / f"{kind}.zip"
        self._below = ""  # what the names of members begin with
        self._known: frozenset[str] | None = None

    def names(self) -> frozenset[str]:
        """The files' names, below the kind's folder; none if neither is there."""
        if self._known is None:
            self._known = frozenset(self._found())
        return self._known

    def read(self, name: str) -> bytes:
        """The content of a file. Raises `InputError` if it is missing, damaged or too large."""
        if name not in self.names():
            raise Absent(f"{self._folder} has no {name}, nor has {self._archive.name}; get it anew")
        if self._folder.is_dir():
            return read_bytes(self._folder / name, _LIMIT)
        return self._zips.read(self._archive, self._below + name)

    def picture(self, name: str) -> Array:
        """The codes (H, W) or (H, W, C) of a PNG, JPEG or AVIF file."""
        return _decoded(self.read(name), self._folder, name)

    def json(self, name: str) -> Any:
        """The value in a JSON file."""
        try:
            value = json.loads(self.read(name))
        except (ValueError, RecursionError) as error:
            raise InputError(f"{self._folder}: {name} is no JSON; get it anew") from error
        check_value(value, f"{self._folder}: {name}")
        return value

    def _found(self) -> Iterator[str]:
        if self._folder.is_dir():
            yield from (path.relative_to(self._folder).as_posix() for path in self._folder.rglob("*") if path.is_file())
        elif self._archive.is_file():
            names = self._zips.names(self._archive)
            below = f"{self._folder.name}/"
            self._below = below if any(name.startswith(below) for name in names) else ""
            yield from (name.removeprefix(self._below) for name in names)


def _decoded(content: bytes, place: Path, name: str) -> Array:
    try:
        with opened_codes(io.BytesIO(content)) as image:
            check_size(place / name, "picture", *image.size)
            return np.asarray(image)
    except InputError:
        raise
    except Exception as error:  # decoders raise their own types for damaged files
        raise InputError(f"{place}: {name} is damaged or no picture ({error}); get it anew") from error


def _opened(path: Path) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(path)
    except FileNotFoundError as error:
        raise Absent(f"{path} does not exist; get it from the capture's authors") from error
    except (zipfile.BadZipFile, OSError) as error:
        raise InputError(f"{path} is no zip archive that can be read ({error}); get it anew") from error
