"""A benchmark and evaluation harness for hand-relighting methods."""

from __future__ import annotations

__version__ = "0.1.0"
