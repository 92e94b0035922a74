"""The machine's memory."""

from __future__ import annotations

import os


def physical_memory() -> int | None:
    """Bytes of the machine, or None where it does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None
