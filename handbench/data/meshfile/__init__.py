"""Meshes from outside: OBJ, PLY and GLB files as surfaces with UVs, read with care.

UVs are handbench's: the origin is bottom-left, as in OBJ; glTF counts from the top and is turned over. Vertices that a
file repeats at the seams of its UVs (PLY, GLB) become one again, so that a surface has no slits.
"""

from __future__ import annotations

from pathlib import Path

from ...errors import InputError
from ...files import read_bytes
from ...scene import Mesh
from .glb import parse_glb
from .obj import parse_obj
from .ply import parse_ply

LIMIT = 128 << 20
"""Bytes of the largest mesh file that is read."""

_PARSERS = {".obj": parse_obj, ".ply": parse_ply, ".glb": parse_glb}
SUFFIXES = tuple(_PARSERS)


def read_mesh(path: Path, unit: float = 1.0, limit: int = LIMIT) -> Mesh:
    """The mesh in a file of at most `limit` bytes; `unit` is how many metres its unit is (0.001 for millimetres).

    Raises `InputError` for a file that is missing, too large, damaged, of another kind, without faces, or whose faces
    point outside it.
    """
    path = Path(path)
    parse = _PARSERS.get(path.suffix.lower())
    if parse is None:
        raise InputError(f"mesh {path} is of an unknown type; expected a file ending in {', '.join(SUFFIXES)}")
    content = read_bytes(path, limit, "mesh")
    try:
        mesh = parse(content)
    except InputError as error:
        raise InputError(f"mesh {path}: {error}") from error
    except (ValueError, KeyError, IndexError, TypeError, OverflowError, RecursionError, MemoryError) as error:
        told = " ".join(str(error).split())[:120]
        raise InputError(f"mesh {path} is damaged ({type(error).__name__}: {told}); export it anew") from error
    return mesh if unit == 1.0 else Mesh(mesh.vertices * unit, mesh.topology)
