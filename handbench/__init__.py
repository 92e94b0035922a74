"""handbench: a benchmark and evaluation harness for hand-relighting methods.

The names here are `run`, `load` and `Results`, which are handbench in Python, and what a plug-in needs: a method, a
capture, and what goes in and out of them. Everything else may change from one version to the next. They are imported
when they are first used, so that a command which needs none of them starts at once.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .data.capture import Capture
    from .errors import InputError, NonFinite, Unsupported
    from .interface import Results, load, run
    from .light.lightset import light_samples
    from .method import Avatar, Method, MethodInfo, PosedAvatar, Prior, Progress, RecordedAvatar
    from .recording import Recording
    from .registry import Entry
    from .render.see.raster import rasterise
    from .render.uv.posed import PosedSurface
    from .scene import (
        Camera,
        Directional,
        Environment,
        Frame,
        Group,
        Mesh,
        Observation,
        Point,
        Pose,
        Prediction,
        Query,
        Topology,
        Unknown,
        Viewpoint,
    )

__version__ = "0.1.0"

_HOMES = {
    "data.capture": ("Capture",),
    "errors": ("InputError", "NonFinite", "Unsupported"),
    "interface": ("Results", "load", "run"),
    "light.lightset": ("light_samples",),
    "method": ("Avatar", "Method", "MethodInfo", "PosedAvatar", "Prior", "Progress", "RecordedAvatar"),
    "recording": ("Recording",),
    "registry": ("Entry",),
    "render.see.raster": ("rasterise",),
    "render.uv.posed": ("PosedSurface",),
    "scene": (
        *("Camera", "Directional", "Environment", "Frame", "Group", "Mesh", "Observation", "Point", "Pose"),
        *("Prediction", "Query", "Topology", "Unknown", "Viewpoint"),
    ),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [*_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
