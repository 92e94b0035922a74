"""From values of frames to what may be claimed: means, intervals, paired differences, Holm's correction.

Values are a matrix (seeds, frames), NaN where there is none; `subjects` (frames,) tells the subject of
each frame by a whole number. The order of averaging is `handbench.bench.protocol.AGGREGATION`: over a subject's
frames, over subjects, over seeds, each over what is there.

Frames of one hand are not independent hands, so draws and tests take subjects, not frames, as the unit. With few
subjects that limits what any method can claim, and we do not hide it: intervals widen (see `interval`), and no test
over n subjects can give a p-value below 2 ** (1 - n) (see `sign_flips`).

A seed is another training. With several, intervals hold what another training would change; with one they tell of
these weights alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..scene import Array

RESAMPLES = 2000
CONFIDENCE = 0.95
_FLIPS = 9999  # random sign flips where there are too many subjects to try all
_BLOCK = 1 << 22  # drawn frames that are held at a time: bounds the memory


@dataclass(frozen=True)
class Difference:
    """A method's value minus another's, over the frames and seeds that have both.

    low, high   95 % interval of the paired difference; None with fewer than two frames
    paired      how many values were paired, of how many `subjects`
    spread      standard deviation of the difference over seeds; None with fewer than two
    p           of no difference, two-sided, by sign flips over subjects; `adjusted` after Holm's correction
    """

    value: float
    low: float | None
    high: float | None
    paired: int
    subjects: int
    spread: float | None = None
    p: float | None = None
    adjusted: float | None = None

    @property
    def separated(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low is not None and self.high is not None and (self.low > 0 or self.high < 0)


def aggregate(values: Array, subjects: Array) -> float | None:
    """The mean over seeds of the mean over subjects of the mean over a subject's frames; None without any value."""
    mean = float(_mean(seed_means(values, subjects)))
    return mean if math.isfinite(mean) else None


def seed_means(values: Array, subjects: Array) -> Array:
    """(..., frames) to (...): the mean over subjects of their means, NaN without any value."""
    return _mean(subject_means(values, subjects))


def subject_means(values: Array, subjects: Array) -> Array:
    """(..., frames) to (..., subjects that occur, in order): the mean of each subject, NaN without any value."""
    return np.stack([_mean(values[..., subjects == subject]) for subject in np.unique(subjects)], axis=-1)


def seed_spread(values: Array, subjects: Array) -> float | None:
    """The standard deviation over seeds of the means of single seeds, or None with fewer than two seeds."""
    means = seed_means(values, subjects)
    means = means[np.isfinite(means)]
    return float(np.std(means, ddof=1)) if len(means) > 1 else None


def bootstrap(values: Array, subjects: Array, seed: int) -> Array:
    """The mean over subjects in each bootstrap draw: (rows, frames) to (rows, RESAMPLES), NaN without any value.

    Two-stage cluster bootstrap: subjects are drawn with replacement, then the frames of each drawn subject. Rows
    with values on the same frames get the same draws, whichever seed, metric or method they are of, so the
    difference of their draws is the draw of their paired difference.
    """
    present = np.isfinite(values)
    found = np.full((len(values), RESAMPLES), np.nan)
    patterns, of_row = np.unique(present, axis=0, return_inverse=True)
    for index, pattern in enumerate(patterns):
        rows = of_row.reshape(-1) == index
        if pattern.any():
            found[rows] = _drawn(values[rows][:, pattern], subjects[pattern], np.random.default_rng(seed))
    return found


def _drawn(values: Array, subjects: Array, generator: np.random.Generator) -> Array:
    members = [np.flatnonzero(subjects == subject) for subject in np.unique(subjects)]
    count = len(members)
    picks = generator.multinomial(count, np.full(count, 1 / count), size=RESAMPLES)
    total = np.zeros((len(values), RESAMPLES))
    for frames, times in zip(members, picks.T, strict=True):
        of_subject, size = values[:, frames], len(frames)
        step = max(1, _BLOCK // size)
        for start in range(0, RESAMPLES, step):
            block = times[start : start + step]
            # A subject that is drawn k times gets k * size frames: that is drawing its frames k times on its own.
            draw = np.repeat(np.arange(len(block)) * size, block * size)
            counts = np.bincount(draw + generator.integers(size, size=len(draw)), minlength=len(block) * size)
            total[:, start : start + step] += of_subject @ counts.reshape(-1, size).T / size
    return total / count


def over_seeds(draws: Array, seed: int) -> Array:
    """Draws of single seeds (seeds, RESAMPLES) to those of their mean, with seeds drawn with replacement as well.

    A seed without values is left out. Rows with as many seeds get the same draws, so that differences stay paired.
    """
    there = draws[np.isfinite(draws[:, 0])]
    if len(there) < 2:
        return _mean(draws.T)
    generator = np.random.default_rng((seed, len(there)))
    shares = generator.multinomial(len(there), np.full(len(there), 1 / len(there)), size=RESAMPLES).T / len(there)
    mixed: Array = (there * shares).sum(axis=0)
    return mixed


def interval(draws: Array, subjects: Array, seed: int) -> tuple[float, float] | None:
    """The 95 % percentile interval of bootstrap draws of single seeds (seeds, RESAMPLES), None with one frame or none.

    `subjects`: of the frames that have a value. Subjects and seeds are drawn together (see `over_seeds`): a crossed
    hierarchical bootstrap, as every seed is scored on every subject. Percentiles of a bootstrap are too narrow for few
    clusters. They are taken further out, at Phi(-f t): f is how much the bootstrap's spread falls short, sqrt(n /
    (n - 1)) for n subjects alone (Hesterberg, What Teachers Should Know About the Bootstrap, 2015, "expanded percentile
    interval"), and t the quantile of Student's distribution. With seeds the two variances add up, each with its own
    shortfall, and the degrees of freedom are those of such a sum (Satterthwaite, Biometrics Bulletin 2, 1946).
    With fewer than six subjects or seeds even the extremes of all draws hold less than 95 %: few hands cannot tell
    about all hands, nor few trainings about all. With one subject the frames take the place of the subjects, and the
    interval is about that subject alone.
    """
    from scipy.special import ndtr, stdtrit

    clusters = len(np.unique(subjects))
    units = clusters if clusters > 1 else len(subjects)
    if units < 2:
        return None
    there = draws[np.isfinite(draws[:, 0])]
    parts = [(float(np.var(there.mean(axis=0))), units)]
    if len(there) > 1:
        parts.append((float(np.var(there.mean(axis=1))) / len(there), len(there)))
    short = sum(variance for variance, _ in parts)  # of the bootstrap, which divides by n where n - 1 is right
    whole = [(variance * count / (count - 1), count - 1) for variance, count in parts]
    total = sum(variance for variance, _ in whole)
    freedom = total**2 / sum(variance**2 / free for variance, free in whole) if total else units - 1
    factor = math.sqrt(total / short) if short else 1.0
    tail = float(ndtr(-factor * float(stdtrit(freedom, (1 + CONFIDENCE) / 2))))
    low, high = np.quantile(over_seeds(draws, seed), (tail, 1 - tail))
    return float(low), float(high)


def differences(
    pairs: Sequence[tuple[Array, Array]], subjects: Array, seed: int, tested: bool = True
) -> list[Difference | None]:
    """First minus second of each pair, (seeds, frames) both, over the frames and seeds that both have.

    With unequal numbers of seeds the means over seeds are paired, and the interval tells of those weights. None where
    nothing pairs; no p-values unless `tested`. All pairs of equal coverage share their draws.
    """
    apart = [_apart(first, second) for first, second in pairs]
    ends = np.cumsum([len(each) for each in apart])[:-1]
    draws = np.split(bootstrap(np.concatenate(apart), subjects, seed), ends) if apart else []
    of_subjects = [_mean(subject_means(each, subjects).T) for each in apart]
    ps = sign_flips(np.stack(of_subjects), seed).tolist() if tested and apart else [None] * len(apart)
    return [_difference(*each, subjects, seed) for each in zip(apart, draws, ps, strict=True)]


def p_values(pairs: Sequence[tuple[Array, Array]], subjects: Array, seed: int) -> list[float]:
    """The p-value of each pair by `sign_flips`, as `differences` gives it, without the interval; 1 where none pairs."""
    of_subjects = [_mean(subject_means(_apart(*pair), subjects).T) for pair in pairs]
    return [float(p) for p in sign_flips(np.stack(of_subjects), seed)] if pairs else []


def _apart(first: Array, second: Array) -> Array:
    if len(first) != len(second):
        first, second = (np.mean(values, axis=0, keepdims=True) for values in (first, second))
    return first - second


def _difference(apart: Array, draws: Array, p: float | None, subjects: Array, seed: int) -> Difference | None:
    value = aggregate(apart, subjects)
    if value is None:
        return None
    present = np.isfinite(apart)
    used = subjects[present.any(axis=0)]
    low, high = interval(draws, used, seed) or (None, None)
    count = len(np.unique(used))
    return Difference(value, low, high, int(present.sum()), count, seed_spread(apart, subjects), p, p)


def sign_flips(apart: Array, seed: int) -> Array:
    """Two-sided p-values (rows,) of no difference, from each row's paired differences of subjects (rows, subjects).

    If two methods are alike, each subject's difference could as well have the other sign: the p-value is the share of
    all 2 ** n choices of signs whose mean is at least as far from zero (9,999 random ones with more than 13 subjects).
    It assumes nothing but that symmetry, and is exact with few subjects, where a bootstrap's p-value is too small.
    The price is honest: it cannot be less than `least_p(n)`. NaN: a subject that a row lacks.
    """
    from scipy.stats import permutation_test

    found = np.ones(len(apart))
    patterns, of_row = np.unique(np.isfinite(apart), axis=0, return_inverse=True)
    for index, pattern in enumerate(patterns):
        if pattern.sum() > 1:
            rows = of_row.reshape(-1) == index
            settings = {"permutation_type": "samples", "n_resamples": _FLIPS, "vectorized": True, "axis": -1}
            generator = np.random.default_rng(seed)
            test = permutation_test((apart[rows][:, pattern],), np.mean, rng=generator, batch=1000, **settings)
            found[rows] = test.pvalue
    return found


def least_p(subjects: int) -> float:
    """The smallest p-value that `sign_flips` can give over so many subjects."""
    return 2.0 ** (1 - max(subjects, 1))


def holm(p: Sequence[float]) -> list[float]:
    """Holm's step-down correction: p-values that bound the chance of one false claim among all of them."""
    order = np.argsort(p, kind="stable")
    factors = np.arange(len(p), 0, -1)
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(np.maximum.accumulate(factors * np.asarray(p, dtype=float)[order]), 1.0)
    return [float(value) for value in adjusted]


def corrected(apart: Sequence[Difference | None], family: Sequence[bool] | None = None) -> list[Difference | None]:
    """The differences with p-values adjusted by `holm` over those in the family (None: all); others keep theirs."""
    known = {i: each.p for i, each in enumerate(apart) if each and each.p is not None and (not family or family[i])}
    adjusted = dict(zip(known, holm(list(known.values())), strict=True))
    return [each and replace(each, adjusted=adjusted.get(i, each.p)) for i, each in enumerate(apart)]


def time_ratio(
    times: Sequence[Sequence[float]], before: Sequence[Sequence[float]], seed: int
) -> tuple[float, float | None, float | None]:
    """How many times as long as before, with its 95 % interval: repeats by cell, the same cells on both sides.

    The geometric mean over cells of the ratio of medians, bootstrapped over cells and, on either side, over repeats.
    No interval if there is but one cell with one repeat on each side. Slow drift of a machine between two runs is in
    no repeat and so not in the interval: a threshold must allow for it.
    """
    generator = np.random.default_rng(seed)
    logs = [np.log(np.median(new)) - np.log(np.median(old)) for new, old in zip(times, before, strict=True)]
    ratio = float(np.exp(np.mean(logs)))
    if len(times) < 2 and max(len(times[0]), len(before[0])) < 2:
        return ratio, None, None

    def medians(repeats: Sequence[float]) -> Array:
        values = np.asarray(repeats, dtype=float)
        drawn: Array = np.log(np.median(values[generator.integers(len(values), size=(RESAMPLES, len(values)))], axis=1))
        return drawn

    draws = np.stack([medians(new) - medians(old) for new, old in zip(times, before, strict=True)], axis=1)
    chosen = generator.integers(len(times), size=draws.shape)
    low, high = np.quantile(np.take_along_axis(draws, chosen, axis=1).mean(axis=1), (0.025, 0.975))
    return ratio, float(np.exp(low)), float(np.exp(high))


def _mean(values: Array) -> Array:
    """The mean of what is finite along the last axis, NaN where nothing is."""
    present = np.isfinite(values)
    count = present.sum(axis=-1)
    total = np.where(present, values, 0.0).sum(axis=-1)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
