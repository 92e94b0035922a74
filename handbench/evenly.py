"""Some of many, evenly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

T = TypeVar("T")


def evenly(items: Sequence[T], most: int) -> list[T]:
    """At most `most` of some items, in their order and evenly spread, the first and the last among them."""
    return [items[round(i)] for i in np.linspace(0, len(items) - 1, min(most, len(items)))]
