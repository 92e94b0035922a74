"""A tracer that draws hands as diffuse surfaces with hard shadows, for tests of methods that look at pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from handbench.data.openstage.trace.pathtrace import PathTracer, TracedSurface
from handbench.methods.kit.albedo import Canvas, flat
from handbench.scene import Array, Camera, Light

TEXTURE = 128


class Shaded(PathTracer):
    """Lambert's law, no bounces; geometry is as it should be."""

    def render(self, surface: TracedSurface, camera: Camera, lights: Sequence[Light], *_: Any, **__: Any) -> Array:
        canvas = Canvas(surface.mesh, camera, TEXTURE)
        albedo = flat(
            torch.nn.functional.adaptive_avg_pool2d(torch.from_numpy(surface.albedo).movedim(2, 0), TEXTURE), canvas
        )
        return np.stack([canvas.lit(light, albedo).image for light in lights])
