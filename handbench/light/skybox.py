"""Ten real HDR environments that the installed open3d package carries as cube maps."""

from __future__ import annotations

import importlib.util
from functools import lru_cache
from pathlib import Path

import numpy as np

from ..data.ktx import read_ktx
from ..errors import InputError, unknown_name
from ..scene import Array, Environment
from .environment import directions, resize, solid_angles, texels

SKYBOXES = (
    "brightday",
    "crossroads",
    "default",
    "hall",
    "konzerthaus",
    "nightlights",
    "park",
    "park2",
    "pillars",
    "streetlamp",
)

_SUPERSAMPLE = 4


def skybox(name: str, height: int, width: int) -> Environment:
    """The named skybox (one of `SKYBOXES`) as an equirectangular map of height x width.

    Raises `InputError` for an unknown name or a file that is missing or damaged.
    """
    if name not in SKYBOXES:
        raise unknown_name("skybox", name, SKYBOXES)
    package = importlib.util.find_spec("open3d")
    if package is None or package.origin is None:
        raise InputError("the skyboxes come with the open3d package, which is not installed; install it")
    path = Path(package.origin).parent / "resources" / f"{name}_skybox.ktx"
    try:
        faces = read_ktx(path)
    except InputError as error:
        raise InputError(f"{error} (reinstall the open3d package)") from error
    return Environment(name, equirectangular(faces, height, width))


def equirectangular(faces: Array, height: int, width: int) -> Array:
    """Cube faces (6, n, n, 3) as an equirectangular map (height, width, 3) float32.

    Radiance up to a bound is looked up on a finer grid and averaged. The excess of the few texels above it
    (suns, lamps: too small for a grid to weigh) is moved over as power, so that their light arrives whole.
    """
    n = faces.shape[1]
    bound = np.quantile(faces, 0.999)
    finer = max(1, -(-_SUPERSAMPLE * n // height))  # the grid has at least two samples across a cube texel
    bulk = Environment("", np.minimum(faces, bound).reshape(-1, 3)[_seen(finer * height, finer * width, n)])
    radiance = resize(bulk, height, width).radiance.astype(np.float64)
    face, row, column = np.nonzero((faces > bound).any(axis=-1))
    part = (np.arange(_SUPERSAMPLE) + 0.5) / _SUPERSAMPLE
    s, t = (2.0 * (where[:, None, None] + offset) / n - 1.0 for where, offset in ((column, part), (row, part[:, None])))
    s, t = np.broadcast_arrays(s, t)
    direction = _direction(face[:, None, None], s, t)
    solid = (2.0 / n / _SUPERSAMPLE) ** 2 * (1.0 + s * s + t * t) ** -1.5
    power = np.maximum(faces[face, row, column].astype(np.float64) - bound, 0.0)[:, None, None] * solid[..., None]
    i, j = texels(direction, height, width)
    np.add.at(radiance, (i, j), power / solid_angles(height, width)[i, j][..., None])
    return radiance.astype(np.float32)


def _direction(face: Array, s: Array, t: Array) -> Array:
    """Unit directions to points (s right, t down, both in [-1, 1]) of cube faces, OpenGL's table.

    OpenGL's faces are left-handed, and Filament's tools, which made these files, store mirrored pictures to
    suit: read into a right-handed world they come out unmirrored (the Bund in "nightlights" shows it).
    """
    one = np.ones_like(s)
    table = ((one, -t, -s), (-one, -t, s), (s, one, t), (s, -one, -t), (s, -t, one), (-s, -t, -one))
    towards = np.choose(face[..., None], [np.stack(axes, axis=-1) for axes in table])
    return towards / np.linalg.norm(towards, axis=-1, keepdims=True)


@lru_cache(maxsize=2)
def _seen(height: int, width: int, n: int) -> Array:
    """Which of the 6 n^2 cube texels each texel of a map shows, (height, width); the same for every skybox."""
    face, row, column = _locate(directions(height, width), n)
    found: Array = ((face * n + row) * n + column).astype(np.int32)
    found.flags.writeable = False
    return found


def _locate(direction: Array, n: int) -> tuple[Array, Array, Array]:
    """The face, row and column of the cube texels (n x n a face) that directions (..., 3) point into."""
    x, y, z = np.moveaxis(direction, -1, 0)
    axis = np.abs(direction).argmax(axis=-1)
    largest = np.take_along_axis(direction, axis[..., None], axis=-1)[..., 0]
    face = 2 * axis + (largest < 0)
    s = np.choose(face, (-z, z, x, x, x, -x)) / np.abs(largest)
    t = np.choose(face, (-y, -y, z, -z, -y, -y)) / np.abs(largest)
    row, column = (np.clip((value + 1.0) * (n / 2), 0, n - 1).astype(int) for value in (t, s))
    return face, row, column
