"""Paths with fields, as "images/{camera}/{pose}.png": which files of a folder fit, and what their names tell."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from ...errors import InputError, shortened

FIELDS = ("subject", "segment", "pose", "camera", "lighting")
_FIELD = re.compile(r"\{([^{}]*)\}")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")  # it becomes part of keys and of file names


@dataclass(frozen=True)
class Pattern:
    """A path below a folder with fields in it."""

    text: str
    fields: tuple[str, ...]

    @staticmethod
    def parse(owner: str, text: Any) -> Pattern:
        """Raises `InputError` for a path that leaves the folder and for a field that is none of `FIELDS`."""
        check_path(owner, text)
        fields = tuple(dict.fromkeys(_FIELD.findall(text)))
        for field in fields:
            if field not in FIELDS:
                raise InputError(f"{owner} has {{{field}}}; its fields are {', '.join(FIELDS)}")
        return Pattern(text, fields)

    def files(self, folder: Path) -> Iterator[tuple[str, dict[str, str]]]:
        """The files that fit, by their path below the folder, in the order of their names, and what these tell.

        Raises `InputError` for a name that cannot be part of a key, and for links that lead out of the folder.
        """
        seen: set[str] = set()
        expression = "".join(
            f"(?P<{piece[1:-1]}>[^/]+)" if piece.startswith("{") and not (piece in seen or seen.add(piece))  # type: ignore[func-returns-value]
            else f"(?P={piece[1:-1]})" if piece.startswith("{")
            else re.escape(piece)
            for piece in re.split(r"(\{[^{}]*\})", self.text)
        )  # fmt: skip
        fits, depth = re.compile(expression), self.text.count("/")
        fixed = self.text.partition("{")[0].rpartition("/")[0]
        for path in sorted(_walk(folder / fixed, depth - (fixed.count("/") + 1 if fixed else 0))):
            relative = path.relative_to(folder).as_posix()
            if (match := fits.fullmatch(relative)) is not None:
                inside(folder, relative)
                for value in match.groupdict().values():
                    check_name(f"file {relative}: {value!r}", value)
                yield relative, match.groupdict()

    def path(self, told: Mapping[str, str]) -> str:
        """The path with its fields filled in."""
        return _FIELD.sub(lambda field: told[field[1]], self.text)


def check_path(owner: str, text: Any) -> str:
    """A path below the folder. Raises `InputError` for anything else."""
    if not isinstance(text, str) or not text or "\0" in text:
        raise InputError(f"{owner} is {shortened(text)}; give a path below the folder")
    path = PurePosixPath(text)
    if path.is_absolute() or ".." in path.parts or "\\" in text or re.match(r"[A-Za-z]:", text):
        raise InputError(f"{owner} is {shortened(text)}, which leads out of the folder; copy what is needed into it")
    return text


def check_name(owner: str, value: Any) -> str:
    """A name that can be part of keys and file names. Raises `InputError` for anything else."""
    if not isinstance(value, str) or not _NAME.fullmatch(value):
        raise InputError(f"{owner} is {shortened(value)}; use up to 64 letters, digits, points, dashes, underscores")
    return value


def inside(folder: Path, relative: str) -> Path:
    """The file at a path below the folder. Raises `InputError` if links lead out of it."""
    path = folder / relative
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{path} is a link that leads out of the folder; copy what it points to")
    return path


def _walk(folder: Path, depth: int) -> Iterator[Path]:
    """The files that lie `depth` folders below; hidden ones and linked folders are left out."""
    if not folder.is_dir():
        return
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith("."):
                continue
            if depth > 0 and entry.is_dir(follow_symlinks=False):
                yield from _walk(folder / entry.name, depth - 1)
            elif depth == 0 and entry.is_file():
                yield folder / entry.name
