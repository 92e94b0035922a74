"""UVs for MANO's surface, which its file has none of: its authors' layout if it lies beside, else one of our own."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import InputError
from ...scene import Array, Topology
from ..handmodel import Side

_MARGIN = 0.06  # of a cell, around each of its two triangles


def read_layout(folder: Path, side: Side) -> Path | None:
    """MANO_UV_right.obj or MANO_UV_left.obj, which MANO's site gives out beside the model; None if it is not there."""
    names = (f"MANO_UV_{side}.obj", f"MANO_UV_{side.upper()}.obj")
    return next((folder / name for name in names if (folder / name).is_file()), None)


def unwrapped(faces: Array, layout: Path | None = None) -> Topology:
    """The surface with UVs: those of a layout's .obj file, or, without one, each triangle in a place of its own.

    Layouts do not fit each other: a texture belongs to one, and `Topology.digest` tells which. Ours serves what works
    texel by texel; networks that look at neighbours in UV want the authors' few charts.
    Raises `InputError` for a layout of other faces.
    """
    if layout is None:
        uvs = _cells(len(faces))
        return Topology(faces, uvs, np.arange(len(uvs)).reshape(-1, 3))
    from ...data.meshfile import read_mesh

    topology = read_mesh(layout).topology
    if not np.array_equal(topology.faces, faces):
        raise InputError(f"UV layout {layout} has other faces than MANO's file; give the one of its authors' site")
    return topology


def _cells(count: int) -> Array:
    """UVs (3 F, 2): a square grid whose cells hold two triangles each, apart by a margin."""
    side = int(np.ceil(np.sqrt((count + 1) // 2)))
    near, far = _MARGIN, 1.0 - _MARGIN
    lower = np.array([[near, near], [far - near, near], [near, far - near]])
    corners = np.stack([lower, 1.0 - lower])  # turned by half a turn: the same winding
    cell = np.arange((count + 1) // 2)
    at = np.stack([cell % side, cell // side], axis=-1)
    return ((at[:, None, None] + corners).reshape(-1, 3, 2)[:count].reshape(-1, 2)) / side
