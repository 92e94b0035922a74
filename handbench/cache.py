"""Where what is generated is kept on this machine."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder() -> Path:
    """$HANDBENCH_DATA, or handbench's folder in the user's cache. It need not exist."""
    chosen = os.environ.get("HANDBENCH_DATA")
    if chosen:
        return Path(chosen).absolute()
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache").absolute() / "handbench"
