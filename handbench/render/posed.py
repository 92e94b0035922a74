"""What one posed mesh shares between lights, cameras and methods, computed once: maps, shadows, rasters."""

from __future__ import annotations

from collections import OrderedDict
from functools import cached_property, lru_cache

import numpy as np
import torch
from torch import Tensor

from ..light.lightset import LightSet
from ..scene import Array, Camera, Mesh
from ..skips import note, skips
from .atlas import Atlas
from .raster import Raster, rasterise
from .shadowmap import SIZE, soft_visibility
from .shadowstore import shadow_store, surface_key
from .surface import Relief, surface_maps
from .visibility import VERSION, visibility

# Bounds of what is kept. A raster is about 5 MB; a pose's hard shadows of 600 lights at 128 texels are about 1 MB.
_POSES, _RASTERS, _SHADOW_BYTES = 64, 96, 256 << 20


class PosedSurface:
    """A posed mesh at the covered texels of an atlas: position and unit normal (3, N), float32."""

    def __init__(self, mesh: Mesh, size: int) -> None:
        self.mesh = mesh
        self.atlas = Atlas.of(mesh.topology, size)
        maps = surface_maps(mesh, self.atlas)
        self.position: Tensor = self.atlas.gather(maps.position)
        self.normal: Tensor = self.atlas.gather(maps.normal)
        self._token = object()  # names its shadows without keeping it alive

    @staticmethod
    def of(mesh: Mesh, size: int) -> PosedSurface:
        """The surface of a mesh at R x R texels; with `Skips.repeated` the last few dozen are kept."""
        return _posed(mesh, size, skips().uncovered) if skips().repeated else PosedSurface(mesh, size)

    @cached_property
    def relief(self) -> Relief:
        """The surface as displacements refine it."""
        return Relief(self.position, self.normal, self.atlas)

    def visibility(self, lights: LightSet, soft: bool = False, texels: Array | None = None) -> Tensor:
        """What of each light reaches the texels, (L + P, N): shadows of the mesh on itself.

        Hard ones are bool, by `visibility`; soft ones are float32 in [0, 1], by `soft_visibility`, rounded to bytes
        (an error of at most 1/510). `texels` (N,) picks from the atlas's covered ones, for who needs no others.
        With `Skips.repeated` shadows are kept by light, packed, in memory and, inside `kept_on_disk`, on disk;
        "shadows known already" says how many texel-light pairs were.
        """
        names = [b"d" + row.tobytes() for row in lights.directions.astype(np.float64, copy=False)]
        names += [b"n" + row.tobytes() for row in lights.positions.astype(np.float64, copy=False)]
        wanted = _Wanted(soft, texels, self.atlas.count if texels is None else len(texels))
        if not names:
            return torch.zeros((0, wanted.count), dtype=torch.float32 if soft else torch.bool)
        rows = self._rows(names, wanted)
        packed = np.stack([rows[name] for name in names])
        if soft:
            return torch.from_numpy(packed).float() / 255.0
        return torch.from_numpy(np.unpackbits(packed, axis=1, count=wanted.count).view(bool))

    def _rows(self, names: list[bytes], wanted: _Wanted) -> dict[bytes, Array]:
        """Packed shadows by light: those known, and the others traced."""
        if not skips().repeated:
            return self._traced(names, wanted)
        key = (self._token, *wanted.key)
        rows = _recent.get(key, names)
        missing = list(dict.fromkeys(name for name in names if name not in rows))
        store = shadow_store() if missing else None
        if store is not None:
            surface = surface_key([], self._digest, *wanted.key)
            kept = store.read(surface, wanted.width)
            rows.update({name: kept[name] for name in missing if name in kept})
            missing = [name for name in missing if name not in rows]
        note("shadows known already", len(names) * wanted.count, sum(name in rows for name in names) * wanted.count)
        if missing:
            fresh = self._traced(missing, wanted)
            rows.update(fresh)
            if store is not None:
                store.write(surface, fresh)
        _recent.put(key, rows)
        return rows

    def _traced(self, names: list[bytes], wanted: _Wanted) -> dict[bytes, Array]:
        distant = [name for name in names if name.startswith(b"d")]
        near = [name for name in names if name.startswith(b"n")]
        directions, positions = (
            np.frombuffer(b"".join(name[1:] for name in some)).reshape(-1, 3) for some in (distant, near)
        )
        trace = soft_visibility if wanted.soft else visibility
        seen = trace(self.mesh, self.atlas, directions, positions, wanted.texels)
        packed = np.rint(seen * 255.0).astype(np.uint8) if wanted.soft else np.packbits(seen, axis=1)
        return dict(zip(distant + near, packed, strict=True))

    @cached_property
    def _digest(self) -> str:
        topology = self.mesh.topology
        return surface_key((self.mesh.vertices, topology.faces, topology.uvs, topology.uv_faces), self.atlas.size)


class _Wanted:
    """Which kind of shadows of which texels, and what names them; `width` bytes hold a light's."""

    def __init__(self, soft: bool, texels: Array | None, count: int) -> None:
        self.soft, self.texels, self.count = soft, texels, count
        self.width = count if soft else -(-count // 8)
        method = ("soft", SIZE) if soft else ("hard",)
        chosen = "all" if texels is None else surface_key([texels])
        self.key: tuple[object, ...] = (*method, VERSION, skips().below_horizon, chosen)


class _Recent:
    """Packed shadows by surface, kind and light: those used last, in a bounded number of bytes."""

    def __init__(self, limit: int) -> None:
        self._limit, self._bytes = limit, 0
        self._groups: OrderedDict[tuple[object, ...], dict[bytes, Array]] = OrderedDict()

    def get(self, key: tuple[object, ...], names: list[bytes]) -> dict[bytes, Array]:
        """The rows that are known of a surface and kind."""
        group = self._groups.get(key, {})
        if group:
            self._groups.move_to_end(key)
        return {name: group[name] for name in names if name in group}

    def put(self, key: tuple[object, ...], rows: dict[bytes, Array]) -> None:
        """Keep rows; what was not used for longest goes."""
        group = self._groups.setdefault(key, {})
        self._groups.move_to_end(key)
        for name in rows.keys() - group.keys():
            group[name] = rows[name].copy()  # a view would keep all of its array alive
            self._bytes += group[name].nbytes
        while self._bytes > self._limit:
            _, old = self._groups.popitem(last=False)
            self._bytes -= sum(row.nbytes for row in old.values())


_recent = _Recent(_SHADOW_BYTES)


@lru_cache(_POSES)
def _posed(mesh: Mesh, size: int, uncovered: bool) -> PosedSurface:
    return PosedSurface(mesh, size)


def raster(mesh: Mesh, camera: Camera) -> Raster:
    """The raster of a mesh in a camera; with `Skips.repeated` the last few dozen are kept."""
    return _raster(mesh, camera) if skips().repeated else rasterise(mesh, camera)


@lru_cache(_RASTERS)
def _raster(mesh: Mesh, camera: Camera) -> Raster:
    return rasterise(mesh, camera)
