"""From per-image values to one number: image → query → subject, with a bootstrap interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from handbench.scene import Array

RESAMPLES = 1000


def mean_over_subjects(values: Mapping[str, Sequence[float]]) -> float:
    """The mean over subjects of each subject's mean over its queries; every list holds at least one finite value."""
    return float(np.mean([np.mean(of_subject) for of_subject in values.values()]))


def interval(values: Mapping[str, Sequence[float]], seed: int) -> tuple[float, float] | None:
    """The 95 % percentile interval of `mean_over_subjects`, or None with fewer than two values.

    Two-stage bootstrap: subjects are drawn with replacement, then each drawn subject's frames, so that
    frames of one hand are not counted as independent hands. Methods with the same subjects and frames
    and the same seed get the same draws.
    """
    subjects = [np.asarray(of_subject, dtype=np.float64) for of_subject in values.values()]
    if sum(map(len, subjects)) < 2:
        return None
    generator = np.random.default_rng(seed)
    chosen = generator.integers(len(subjects), size=(RESAMPLES, len(subjects)))
    means = np.empty(chosen.shape)
    for index, of_subject in enumerate(subjects):
        drawn = chosen == index
        frames: Array = generator.integers(len(of_subject), size=(int(drawn.sum()), len(of_subject)))
        means[drawn] = of_subject[frames].mean(axis=1)
    low, high = np.percentile(means.mean(axis=1), (2.5, 97.5))
    return float(low), float(high)
