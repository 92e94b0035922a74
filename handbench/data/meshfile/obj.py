"""Wavefront OBJ: vertices, UVs and polygons; groups, materials and normals are not looked at."""

from __future__ import annotations

import io
from collections.abc import Iterable

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
    # all of its lines at once take ten times its size
    for number, line in enumerate(io.TextIOWrapper(io.BytesIO(content), "utf-8", "replace", newline="\n"), start=1):
        kind, *fields = line.partition("#")[0].split() or [""]
        try:
            if kind == "v":
                vertices.append([*map(float, fields[:3])])
            elif kind == "vt":
                uvs.append([*map(float, fields[:2])])
            elif kind == "f":
                if len(fields) < 3:
                    raise ValueError("a face has fewer than three corners")
                # as far as all corners have it: of the vertex, of its UV, of its normal
                of_vertex, *more = zip(*(field.split("/") for field in fields), strict=False)
                polygons.append(_indices(of_vertex, len(vertices)))
                if more and all(more[0]):
                    unwrapped.append(_indices(more[0], len(uvs)))
        except ValueError as error:
            raise InputError(f"line {number} cannot be read ({error}); it is damaged, export it anew") from error
    if unwrapped and len(unwrapped) != len(polygons):
        raise InputError(f"{len(polygons) - len(unwrapped)} of its {len(polygons)} faces have no UVs; unwrap all of it")
    at = np.array(vertices, np.float64).reshape(-1, 3)
    if not unwrapped:
        return surface(at, triangles(polygons), None, None)
    return surface(at, triangles(polygons), np.array(uvs, np.float64).reshape(-1, 2), triangles(unwrapped))


def _indices(texts: Iterable[str], count: int) -> list[int]:
    numbers = [*map(int, texts)]
    if 0 in numbers:
        raise ValueError("corners count from 1")
    return [number - 1 if number > 0 else count + number for number in numbers]
