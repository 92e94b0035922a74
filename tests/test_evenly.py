"""Some of many, evenly spread."""

from __future__ import annotations

import numpy as np
import pytest

from handbench.evenly import evenly


@pytest.mark.parametrize("count", [0, 1, 2, 7, 100])
@pytest.mark.parametrize("most", [0, 1, 2, 3, 7, 40])
def test_items_are_spread_from_the_first_to_the_last_and_none_comes_twice(count: int, most: int) -> None:
    chosen = evenly(range(count), most)
    assert len(chosen) == len(set(chosen)) == min(count, most) and chosen == sorted(chosen)
    if len(chosen) > 1:
        assert (chosen[0], chosen[-1]) == (0, count - 1)
        assert np.ptp(np.diff(chosen)) <= 1
