"""open3d without the web pages of its viewer."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

_PAGES = "open3d.visualization.draw_plotly"


def open3d() -> Any:
    """The open3d package. It loads dash and plotly for a viewer in a browser, half of the time that its import takes:
    here they are loaded when somebody calls that viewer, and not before."""
    if "open3d" not in sys.modules:
        sys.modules[_PAGES] = _Later(_PAGES)
        try:
            import_module("open3d")
        finally:
            sys.modules.pop(_PAGES, None)
    return import_module("open3d")


class _Later(ModuleType):
    """A module whose functions load it when they are called."""

    def __getattr__(self, name: str) -> Any:
        def call(*arguments: Any, **named: Any) -> Any:
            return getattr(import_module(self.__name__), name)(*arguments, **named)

        return call
