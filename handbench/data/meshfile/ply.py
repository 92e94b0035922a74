"""PLY, in ASCII and binary: vertices, polygons, UVs of vertices (s, t; u, v; texture_u, texture_v) or of corners."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from ...errors import InputError
from ...scene import Array, Mesh
from .surface import surface, triangles, welded

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_UVS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_CORNERS = 1 << 16  # of one face
_MOST = 4_000_000  # vertices or faces


@dataclass
class _Element:
    """name, count, and its properties: name, type, and the type of its length if it is a list."""

    name: str
    count: int
    properties: list[tuple[str, str, str | None]] = field(default_factory=list)


def parse_ply(content: bytes) -> Mesh:
    """The mesh in a PLY file."""
    values = _elements(content)
    vertex, face = values.get("vertex", {}), values.get("face", {})
    at = _positions(vertex)
    polygons = face.get("vertex_indices", face.get("vertex_index", []))
    if any(len(polygon) < 3 for polygon in polygons):
        raise InputError("a face has fewer than three corners; export it anew")
    faces = triangles(polygons)
    corners = face.get("texcoord", [])
    if len(corners) and all(len(c) == 2 * len(p) for c, p in zip(corners, polygons, strict=True)):
        ends = np.cumsum([0, *(len(polygon) for polygon in polygons)])
        unwrapped = triangles([range(start, end) for start, end in pairwise(ends.tolist())])
        return surface(at, faces, np.concatenate(corners).reshape(-1, 2).astype(np.float64), unwrapped)
    names = next((pair for pair in _UVS if all(name in vertex for name in pair)), None)
    uvs = None if names is None else np.stack([vertex[name] for name in names], axis=-1).astype(np.float64)
    return welded(at, faces, uvs)


def read_vertices(content: bytes) -> Array:
    """The vertices (V, 3) in a PLY file, in its order; it may have no faces. Raises `InputError` for one without."""
    return _positions(_elements(content).get("vertex", {}))


def _elements(content: bytes) -> dict[str, dict[str, Any]]:
    head, found, body = content.partition(b"end_header")
    if not content.startswith(b"ply") or not found:
        raise InputError("it is no PLY file, or its header is cut off; export it anew")
    kind, elements = _header(head.decode("ascii", "replace"))
    body = body[body.index(b"\n") + 1 :]
    read = _ascii if kind == "ascii" else _binary
    return read(body, elements, ">" if kind == "binary_big_endian" else "<")


def _positions(vertex: dict[str, Any]) -> Array:
    if not all(axis in vertex for axis in "xyz"):
        raise InputError("its vertices have no x, y, z; export it anew")
    return np.stack([vertex[axis] for axis in "xyz"], axis=-1).astype(np.float64)


def _header(text: str) -> tuple[str, list[_Element]]:
    kind, elements = "", []
    for line in text.splitlines():
        match line.split():
            case ["format", ("ascii" | "binary_little_endian" | "binary_big_endian") as kind, *_]:
                pass
            case ["element", name, count]:
                elements.append(_Element(name, int(count)))
            case ["property", "list", length, of, name] if elements:
                elements[-1].properties.append((name, _TYPES[of], _TYPES[length]))
            case ["property", of, name] if elements:
                elements[-1].properties.append((name, _TYPES[of], None))
    if not kind:
        raise InputError("its header states no format that is known; export it as binary or ASCII PLY")
    if not all(0 <= element.count <= _MOST for element in elements):
        raise InputError(f"its header counts less than nothing, or more than {_MOST:,}; export a smaller mesh")
    return kind, elements


def _binary(body: bytes, elements: list[_Element], order: str) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    at = 0
    for element in elements:
        if all(length is None for _, _, length in element.properties):
            dtype = np.dtype([(name, order + of) for name, of, _ in element.properties])
            if at + dtype.itemsize * element.count > len(body):
                raise InputError("it is cut off; export it anew")
            rows = np.frombuffer(body, dtype, element.count, at)
            at += dtype.itemsize * element.count
            found[element.name] = {name: rows[name] for name, _, _ in element.properties}
            continue
        columns: dict[str, list[Array]] = {name: [] for name, _, _ in element.properties}
        if element.count > len(body):
            raise InputError("it is cut off; export it anew")
        for _ in range(element.count):
            for name, of, length in element.properties:
                count = 1
                if length is not None:
                    count = int(np.frombuffer(body, order + length, 1, at)[0])
                    at += np.dtype(length).itemsize
                if not 0 <= count <= _CORNERS:
                    raise InputError("a list in it has no length; it is damaged, export it anew")
                columns[name].append(np.frombuffer(body, order + of, count, at))
                at += np.dtype(of).itemsize * count
        found[element.name] = columns
    return found


def _ascii(body: bytes, elements: list[_Element], order: str) -> dict[str, dict[str, Any]]:
    lines, found = iter(body.decode("ascii", "replace").splitlines()), {}
    for element in elements:
        columns: dict[str, list[Array]] = {name: [] for name, _, _ in element.properties}
        for _ in range(element.count):
            row = np.array(next(lines, "").split(), np.float64)
            at = 0
            for name, of, length in element.properties:
                count = 1
                if length is not None:
                    count, at = int(row[at]), at + 1
                if at + count > len(row):
                    raise InputError("it is cut off; export it anew")
                columns[name].append(row[at : at + count].astype(of))
                at += count
        single = {name for name, _, length in element.properties if length is None}
        found[element.name] = {n: np.concatenate(c) if n in single and c else c for n, c in columns.items()}
    return found
