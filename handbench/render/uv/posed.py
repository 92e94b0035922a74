"""A posed mesh, and its surface at the texels of an atlas, with the shadows found so far.

Both are values: who poses a hand makes them, holds them while lights change, and drops them.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from ...light.lightset import LightSet
from ...scene import Array, Mesh
from ...skips import note, skips
from ..see.posedmesh import PosedMesh
from ..see.shadowmap import SIZE, SoftShadows
from ..see.shadowstore import shadow_store, surface_key
from ..see.visibility import VERSION, HardShadows
from .atlas import Atlas
from .columns import unit_columns
from .surface import Relief

CPU = torch.device("cpu")


class PosedSurface:
    """A posed mesh at the covered texels of an atlas of R x R: position and unit normal (3, N), float32.

    They, and what `visibility` answers, are on a device: rays are traced on the CPU, shading goes where its maps are.
    """

    def __init__(self, mesh: Mesh | PosedMesh, size: int, device: torch.device = CPU) -> None:
        self.mesh = PosedMesh.of(mesh)
        self.atlas = Atlas.of(self.mesh.topology, size)
        position, normal = (self.atlas.interpolate(values).T for values in (self.mesh.vertices, self.mesh.normals))
        self.position, self.normal = (
            torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32)).to(device)
            for values in (position, unit_columns(normal))
        )
        self._shadows: dict[tuple[object, ...], dict[bytes, Array]] = {}  # packed rows by light, by kind of shadows

    @cached_property
    def relief(self) -> Relief:
        """The surface as displacements refine it."""
        return Relief(self.position, self.normal, self.atlas)

    @cached_property
    def _hard(self) -> HardShadows:
        return HardShadows(self.mesh, self.atlas)

    @cached_property
    def _soft(self) -> SoftShadows:
        return SoftShadows(self.mesh, self.atlas)

    def visibility(self, lights: LightSet, soft: bool = False, texels: Array | None = None) -> Tensor:
        """What of each light reaches the texels, (L + P, N): shadows of the mesh on itself.

        Hard ones are bool, by `visibility`; soft ones are float32 in [0, 1], by `soft_visibility`, rounded to bytes
        (an error of at most 1/510). `texels` (N,) picks from the atlas's covered ones, for callers that need no others.
        Hard shadows of `coarse` lights are filled in, see `HardShadows.visible`.
        With `Skips.known` shadows are kept by light, packed, in this object and, inside `kept_on_disk`, on
        disk; "shadows known already" says how many texel-light pairs were.
        """
        names = [b"d" + row.tobytes() for row in lights.directions.astype(np.float64, copy=False)]
        names += [b"n" + row.tobytes() for row in lights.positions.astype(np.float64, copy=False)]
        count = self.atlas.count if texels is None else len(texels)
        if not names:
            kind = torch.float32 if soft else torch.bool
            return torch.zeros((0, count), dtype=kind, device=self.position.device)
        filled = np.zeros(len(names), dtype=bool)
        if lights.coarse is not None and not soft and skips().agreed:
            filled[: len(lights.coarse)] = lights.coarse
        rows: dict[bytes, Array] = {}
        for fill in (False, True):
            some = [name for name, chosen in zip(names, filled == fill, strict=True) if chosen]
            rows.update(self._rows(some, _Wanted(soft, texels, count, fill)) if some else {})
        packed = np.stack([rows[name] for name in names])
        if soft:
            return torch.from_numpy(packed).to(self.position.device).float() / 255.0
        return torch.from_numpy(np.unpackbits(packed, axis=1, count=count).view(bool)).to(self.position.device)

    def _rows(self, names: list[bytes], wanted: _Wanted) -> dict[bytes, Array]:
        """Packed shadows by light: those known, and the others traced."""
        if not skips().known:
            return self._traced(names, wanted)
        rows = self._shadows.setdefault(wanted.key, {})
        missing = list(dict.fromkeys(name for name in names if name not in rows))
        store = shadow_store() if missing else None
        if store is not None:
            surface = surface_key([], self._digest, *wanted.key)
            kept = store.read(surface, wanted.width)
            rows.update({name: kept[name] for name in missing if name in kept})
            missing = [name for name in missing if name not in rows]
        known = len(names) - sum(name in set(missing) for name in names)
        note("shadows known already", len(names) * wanted.count, known * wanted.count)
        if missing:
            fresh = self._traced(missing, wanted)
            rows.update(fresh)
            if store is not None:
                store.write(surface, fresh)
        return rows

    def _traced(self, names: list[bytes], wanted: _Wanted) -> dict[bytes, Array]:
        distant = [name for name in names if name.startswith(b"d")]
        near = [name for name in names if name.startswith(b"n")]
        directions, positions = (
            np.frombuffer(b"".join(name[1:] for name in some)).reshape(-1, 3) for some in (distant, near)
        )
        if wanted.soft:
            seen = self._soft.visible(directions, positions, wanted.texels)
        else:
            seen = self._hard.visible(directions, positions, wanted.texels, wanted.fill)
        packed = np.rint(seen * 255.0).astype(np.uint8) if wanted.soft else np.packbits(seen, axis=1)
        return dict(zip(distant + near, packed, strict=True))

    @cached_property
    def _digest(self) -> str:
        topology = self.mesh.topology
        return surface_key((self.mesh.vertices, topology.faces, *topology.unwrapped), self.atlas.size)


class _Wanted:
    """Which kind of shadows of which texels, and what names them; `width` bytes hold a light's."""

    def __init__(self, soft: bool, texels: Array | None, count: int, fill: bool) -> None:
        self.soft, self.texels, self.count = soft, texels, count
        self.fill = fill
        self.width = count if soft else -(-count // 8)
        method = ("soft", SIZE) if soft else ("hard", self.fill)
        chosen = "all" if texels is None else surface_key([texels])
        self.key: tuple[object, ...] = (*method, VERSION, skips().below_horizon, chosen)
