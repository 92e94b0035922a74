"""The reflectance models that shading knows, and how many responses each has; what they are is in `shading`."""

from __future__ import annotations

from typing import Literal, TypeAlias

Model: TypeAlias = Literal["brdf", "phong", "diffuse"]
"""The models of `light_features`; "disney" has features of its own, see `disney_radiance`."""

RESPONSES = {"brdf": 2, "phong": 2, "diffuse": 1, "disney": 3}
