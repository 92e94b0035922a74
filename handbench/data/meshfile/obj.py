"""Wavefront OBJ: vertices, UVs and polygons; groups, materials and normals are not looked at."""

from __future__ import annotations

import io

import numpy as np

from ...errors import InputError
from ...scene import Mesh
from .surface import surface, triangles


def parse_obj(content: bytes) -> Mesh:
    """The mesh in an OBJ file. Faces count from 1, or from the end where they are negative."""
    vertices: list[list[float]] = []
    uvs: list[list[float]] = []
    polygons: list[list[int]] = []
    unwrapped: list[list[int]] = []
    for number, line in enumerate(io.BytesIO(content), start=1):  # all of its lines at once take ten times its size
        kind, *fields = line.decode("utf-8", "replace").split("#", 1)[0].split() or [""]
        try:
            if kind == "v":
                vertices.append([float(value) for value in fields[:3]])
            elif kind == "vt":
                uvs.append([float(value) for value in fields[:2]])
            elif kind == "f":
                corners = [field.split("/") for field in fields]
                if len(corners) < 3:
                    raise ValueError("a face has fewer than three corners")
                polygons.append([_index(corner[0], len(vertices)) for corner in corners])
                if all(len(corner) > 1 and corner[1] for corner in corners):
                    unwrapped.append([_index(corner[1], len(uvs)) for corner in corners])
        except (ValueError, IndexError) as error:
            raise InputError(f"line {number} cannot be read ({error}); it is damaged, export it anew") from error
    if unwrapped and len(unwrapped) != len(polygons):
        raise InputError(f"{len(polygons) - len(unwrapped)} of its {len(polygons)} faces have no UVs; unwrap all of it")
    at = np.array(vertices, np.float64).reshape(-1, 3)
    if not unwrapped:
        return surface(at, triangles(polygons), None, None)
    return surface(at, triangles(polygons), np.array(uvs, np.float64).reshape(-1, 2), triangles(unwrapped))


def _index(text: str, count: int) -> int:
    number = int(text)
    if number == 0:
        raise ValueError("corners count from 1")
    return number - 1 if number > 0 else count + number
