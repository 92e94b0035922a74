"""From per-query values to one number, in the order of `handbench.bench.protocol.AGGREGATION`, with an interval.

Values are given by seed, by subject, by query: the mean over a subject's queries, then over subjects, then over
seeds. Every list holds at least one finite value.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np

from handbench.scene import Array

RESAMPLES = 1000
Values: TypeAlias = Mapping[int, Mapping[str, Sequence[float]]]


def aggregate(values: Values) -> float:
    """The mean over seeds of the mean over subjects of the mean over a subject's queries."""
    return float(np.mean(_by_seed(values)))


def seed_spread(values: Values) -> float | None:
    """The standard deviation over seeds of the means of single seeds, or None with fewer than two seeds."""
    return float(np.std(_by_seed(values), ddof=1)) if len(values) > 1 else None


def _by_seed(values: Values) -> list[float]:
    return [float(np.mean([np.mean(of_subject) for of_subject in subjects.values()])) for subjects in values.values()]


def interval(values: Values, seed: int) -> tuple[float, float] | None:
    """The 95 % percentile interval of `aggregate`, or None if no seed has two values.

    Two-stage bootstrap: subjects are drawn with replacement, then each drawn subject's frames, so that
    frames of one hand are not counted as independent hands. Methods, and seeds of a method, with the same
    subjects and frames get the same draws: another training is no new frame.
    """
    if max(sum(map(len, subjects.values())) for subjects in values.values()) < 2:
        return None
    means = np.mean([_resampled(subjects, np.random.default_rng(seed)) for subjects in values.values()], axis=0)
    low, high = np.percentile(means, (2.5, 97.5))
    return float(low), float(high)


def _resampled(values: Mapping[str, Sequence[float]], generator: np.random.Generator) -> Array:
    """The mean over subjects of each bootstrap draw, (RESAMPLES,)."""
    subjects = [np.asarray(of_subject, dtype=np.float64) for of_subject in values.values()]
    chosen = generator.integers(len(subjects), size=(RESAMPLES, len(subjects)))
    means = np.empty(chosen.shape)
    for index, of_subject in enumerate(subjects):
        drawn = chosen == index
        frames: Array = generator.integers(len(of_subject), size=(int(drawn.sum()), len(of_subject)))
        means[drawn] = of_subject[frames].mean(axis=1)
    return means.mean(axis=1)
