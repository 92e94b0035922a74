"""A path tracer that draws in no time, for tests of everything else about captures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from handbench.data.openstage.trace.pathtrace import PathTracer, TracedSurface
from handbench.scene import Array, Camera, Light


class Quick(PathTracer):
    """Flat hands; geometry is as it should be."""

    def render(self, surface: TracedSurface, camera: Camera, lights: Sequence[Light], *_: Any, **__: Any) -> Array:
        alpha = self.gbuffer(surface, camera, 4).alpha
        return np.stack([alpha[..., None] * (surface.albedo.mean((0, 1)) + i) for i, _ in enumerate(lights)])
