"""Which of many frames are taken where a protocol caps their number."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

import numpy as np

from ..scene import Frame


def sample(frames: Iterable[Frame], limit: int | None, seed: int) -> tuple[Frame, ...]:
    """At most `limit` frames, spread evenly over subject, pose, camera and light and over every pair of them.

    Greedy: always take the frame whose values were taken least; ties are broken by a seeded shuffle, so the
    choice does not depend on the order of `frames`. Returned in the order of their keys.
    """
    ordered = sorted(frames, key=lambda frame: frame.key)
    if limit is None or len(ordered) <= limit:
        return tuple(ordered)
    order = np.random.default_rng(seed).permutation(len(ordered))
    values = [(f.subject, f.pose_name, f.camera.name, f.lighting) for f in (ordered[i] for i in order)]
    axes = [(i,) for i in range(4)] + list(combinations(range(4), 2))
    codes = []  # per axis and per pair of axes: the value of each frame as an integer
    for axis in axes:
        keys = [tuple(value[i] for i in axis) for value in values]
        names = {key: code for code, key in enumerate(dict.fromkeys(keys))}
        codes.append(np.array([names[key] for key in keys]))
    # A value's count is weighed by how many values its axis has: what is taken against its fair share. Single axes
    # come first, pairs decide between equals.
    weights = [len(np.unique(code)) * (100 if i < 4 else 1) for i, code in enumerate(codes)]
    taken = [np.zeros(code.max() + 1) for code in codes]
    left = np.zeros(len(values))
    chosen: list[int] = []
    for _ in range(limit):
        cost = left + sum(w * count[code] for w, code, count in zip(weights, codes, taken, strict=True))
        best = int(np.argmin(cost))
        chosen.append(int(order[best]))
        left[best] = np.inf
        for code, count in zip(codes, taken, strict=True):
            count[code[best]] += 1
    return tuple(ordered[i] for i in sorted(chosen))
