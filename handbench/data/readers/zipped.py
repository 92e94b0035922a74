"""Files in zip archives of others, read with care: looked at before memory is taken, nothing is written."""

from __future__ import annotations

import io
import warnings
import zipfile
from functools import lru_cache
from pathlib import Path

import numpy as np

from ...errors import Absent, InputError
from ...scene import Array
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
        from PIL import Image

        content = self.read(path, member)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the limit is ours
                with Image.open(io.BytesIO(content), formats=("PNG", "JPEG", "AVIF")) as image:
                    check_size(path / member, "picture", *image.size)
                    return np.asarray(image)
        except InputError:
            raise
        except Exception as error:  # decoders raise their own types for damaged files
            raise InputError(f"{path}: {member} is damaged or no picture ({error}); get it anew") from error

    def first(self, path: Path, suffix: str) -> str:
        """The first member of a suffix. Raises `InputError` if there is none."""
        found = next((name for name in self._archive(path).namelist() if name.endswith(suffix)), None)
        if found is None:
            raise InputError(f"{path} has no {suffix} files; get it anew")
        return found


def _opened(path: Path) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(path)
    except FileNotFoundError as error:
        raise Absent(f"{path} does not exist; get it from the capture's authors") from error
    except (zipfile.BadZipFile, OSError) as error:
        raise InputError(f"{path} is no zip archive that can be read ({error}); get it anew") from error
