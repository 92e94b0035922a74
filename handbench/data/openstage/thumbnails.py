"""How far a making of a capture is from the package's: small pictures of a few fixed views, compared once it is made.

Two machines make the same capture of a recipe though their rounding differs; here that difference is measured.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...evenly import evenly
from ...scene import Array
from ..arrays import read_arrays
from ..exr import read_exr, stack
from .inventory import files
from .manifest import Manifest

KEPT = Path(__file__).with_name("thumbnails.npz")
BOUND = 0.01
"""The greatest difference, relative to a picture's mean. Half floats round to less than a twentieth of it; machines
that round otherwise should make little more, which has not been measured. What is above was not made by this code, or
is damaged."""
_VIEWS = 4  # of a preset
_ROWS = 32  # of a thumbnail, at most
_DARK = 1e-3  # mean of a picture that counts as one


@dataclass(frozen=True)
class PictureDifference:
    """views: how many were compared; largest: the greatest difference, relative to the mean of a picture."""

    views: int
    largest: float


def chosen(manifest: Manifest) -> list[str]:
    """The fixed views: a few pictures, spread over the capture."""
    pictures = [name for name in files(manifest) if re.fullmatch(r"[^/]+/[^/]+/[^/]+/(?!geometry)[^/]+\.exr", name)]
    return evenly(pictures, _VIEWS)


def thumbnail(path: Path) -> Array:
    """The picture of a file in blocks, (h, w, 3) float32, of at most `_ROWS`. Raises `InputError` if it is damaged."""
    image = stack(read_exr(path), ("R", "G", "B"), path)
    size = -(-image.shape[0] // _ROWS)
    height, width = (side // size for side in image.shape[:2])
    blocks = image[: height * size, : width * size].reshape(height, size, width, size, 3)
    return blocks.mean(axis=(1, 3)).astype(np.float32)


def difference(manifest: Manifest, folder: Path, kept: Mapping[str, Array] | None = None) -> PictureDifference | None:
    """How far the capture in `folder` is from the package's making, or None if the package has no pictures of it.

    Raises `InputError` if it is above `BOUND`.
    """
    recipe = manifest["recipe"]
    kept = _kept(recipe) if kept is None else kept
    if not kept:
        return None
    largest = 0.0
    for name in chosen(manifest):
        theirs = np.asarray(kept[f"{recipe}/{name}"], np.float32)
        off = float(np.abs(thumbnail(folder / name) - theirs).mean() / max(theirs.mean(), _DARK))
        if not off <= BOUND:
            raise InputError(
                f"{folder / name} differs by {off:.2%} from the picture of the package, rounding makes at most "
                f"{BOUND:.0%}; install the versions of constraints.txt, delete the folder and make the capture again"
            )
        largest = max(largest, off)
    return PictureDifference(len(chosen(manifest)), largest)


def _kept(recipe: str) -> dict[str, Any]:
    if not KEPT.is_file():
        return {}
    with zipfile.ZipFile(KEPT) as archive:  # most recipes have none
        if not any(name.startswith(recipe) for name in archive.namelist()):
            return {}
    return {name: image for name, image in read_arrays(KEPT).items() if name.startswith(recipe)}
