"""Means, intervals, paired differences and corrections, against theory, scipy and hand-worked examples."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from handbench.results.statistics import (
    RESAMPLES,
    Difference,
    aggregate,
    bootstrap,
    corrected,
    differences,
    holm,
    interval,
    least_p,
    over_seeds,
    seed_spread,
    sign_flips,
    time_ratio,
)
from handbench.scene import Array

NAN = float("nan")


def _interval(values: Array, subjects: Array, seed: int = 0) -> tuple[float, float]:
    found = interval(bootstrap(values, subjects, seed), subjects, seed)
    assert found is not None
    return found


def test_subjects_and_seeds_weigh_alike_whatever_their_number_of_frames() -> None:
    subjects = np.array([0, 0, 0, 0, 1])
    assert aggregate(np.array([[0.0, 0.0, 0.0, 0.0, 10.0]]), subjects) == 5.0
    # Of seed 1, subject 0 has no value. Seeds first would give (0 + (10 + 20) / 2) / 2 = 7.5.
    values = np.array([[0.0, 0.0, NAN, NAN, 10.0], [NAN, NAN, NAN, NAN, 20.0]])
    assert aggregate(values, subjects) == 12.5
    assert seed_spread(values, subjects) == pytest.approx(np.std([5, 20], ddof=1))
    assert aggregate(np.full((2, 5), NAN), subjects) is None and seed_spread(values[:1], subjects) is None


def test_the_bootstrap_of_one_frame_a_subject_is_scipys() -> None:
    values = np.random.default_rng(1).normal(30, 2, 40)
    low, high = _interval(values[None], np.arange(40))
    theirs = stats.bootstrap((values,), np.mean, method="percentile", n_resamples=20_000, rng=0).confidence_interval
    width = theirs.high - theirs.low
    # Ours is wider by sqrt(40 / 39) t / z = 1.045.
    assert (high - low) / width == pytest.approx(1.045, abs=0.05)
    assert (high + low) / 2 == pytest.approx((theirs.high + theirs.low) / 2, abs=0.05 * width)


def test_the_variance_of_draws_is_that_of_two_stages() -> None:
    """Var = between subjects / n + mean over subjects of their variance / frames / n, in closed form."""
    rng = np.random.default_rng(5)
    subjects = np.repeat(np.arange(4), [3, 10, 6, 8])
    values = rng.normal(size=27) + subjects
    of_subject = [values[subjects == s] for s in range(4)]
    between = np.var([v.mean() for v in of_subject]) / 4
    within = np.mean([v.var() / len(v) for v in of_subject]) / 4
    draws = np.concatenate([bootstrap(values[None], subjects, seed)[0] for seed in range(20)])
    assert np.var(draws) == pytest.approx(between + within, rel=0.03)
    assert draws.mean() == pytest.approx(np.mean([v.mean() for v in of_subject]), abs=0.01)


def test_frames_of_one_subject_do_not_count_as_independent() -> None:
    rng = np.random.default_rng(2)
    hands = rng.normal(30, 3, 8)
    clustered = np.concatenate([hand + rng.normal(0, 0.1, 50) for hand in hands])
    wide = np.subtract(*_interval(clustered[None], np.repeat(np.arange(8), 50)))
    assert wide == pytest.approx(np.subtract(*_interval(hands[None], np.arange(8))), rel=0.1)
    assert abs(wide) > 5 * abs(np.subtract(*_interval(clustered[None], np.arange(400))))


def test_rows_with_the_same_frames_share_their_draws() -> None:
    rng = np.random.default_rng(3)
    subjects = np.repeat(np.arange(4), 5)
    values = rng.normal(size=(3, 20))
    values[1, 7] = NAN
    draws = bootstrap(values, subjects, 0)
    apart = bootstrap((values[0] - values[2])[None], subjects, 0)[0]
    assert draws[0] - draws[2] == pytest.approx(apart, abs=1e-12)
    assert draws[1] == pytest.approx(bootstrap(values[1:2], subjects, 0)[0])
    assert np.isnan(bootstrap(np.full((1, 20), NAN), subjects, 0)).all()


def test_another_seed_with_the_same_values_narrows_no_interval() -> None:
    subjects = np.repeat(np.arange(4), 9)
    values = np.random.default_rng(0).normal(size=(1, 36))
    assert _interval(np.repeat(values, 3, axis=0), subjects) == pytest.approx(_interval(values, subjects))


def test_the_interval_repeats_and_needs_two_frames() -> None:
    values, subjects = np.random.default_rng(0).normal(size=(1, 36)), np.repeat(np.arange(4), 9)
    assert _interval(values, subjects, 5) == _interval(values, subjects, 5) != _interval(values, subjects, 6)
    draws = bootstrap(np.array([[1.0], [2.0]]), np.array([0]), 0)
    assert over_seeds(draws, 0).shape == (RESAMPLES,) and interval(draws, np.array([0]), 0) is None


def test_many_frames_are_drawn_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    values, subjects = np.random.default_rng(0).normal(size=(2, 60)), np.repeat(np.arange(3), 20)
    whole = bootstrap(values, subjects, 0)
    monkeypatch.setattr("handbench.results.statistics._BLOCK", 20 * 300)
    blocks = bootstrap(values, subjects, 0)
    assert blocks.mean() == pytest.approx(whole.mean(), abs=0.02) and blocks.std() == pytest.approx(
        whole.std(), rel=0.1
    )


@pytest.mark.parametrize(("subjects", "least"), [(6, 0.90), (12, 0.92), (30, 0.93)])
def test_intervals_cover_what_they_promise(subjects: int, least: float) -> None:
    """Subjects that differ as much as frames: how many of 300 intervals of new subjects hold the true mean, 0."""
    rng = np.random.default_rng(7)
    owners = np.repeat(np.arange(subjects), 10)
    values = rng.normal(size=(300, subjects))[:, owners] + rng.normal(size=(300, len(owners)))
    found = [interval(draws[None], owners, 0) for draws in bootstrap(values, owners, 0)]
    share = np.mean([low <= 0 <= high for low, high in filter(None, found)])
    assert least <= share <= 0.99


@pytest.mark.parametrize(("seeds", "least", "most"), [(8, 0.90, 1.0), (2, 0.4, 0.85)])
def test_intervals_over_seeds_cover_other_trainings(seeds: int, least: float, most: float) -> None:
    """Trainings that differ: how many of 100 intervals of new subjects and new seeds hold the true mean, 0.

    With two seeds the extremes of all draws hold less than 95 %. Intervals over subjects alone hold 54 % and 42 %.
    """
    rng = np.random.default_rng(11)
    owners = np.repeat(np.arange(8), 4)
    trainings, hands = rng.normal(0, 2, size=(100, seeds, 1)), rng.normal(0, 0.7, size=(100, 1, 8))
    values = trainings + hands[..., owners] + rng.normal(size=(100, seeds, len(owners)))
    draws = bootstrap(values.reshape(-1, len(owners)), owners, 0).reshape(100, seeds, -1)
    both = [interval(each, owners, 0) for each in draws]
    subjects_alone = [interval(each.mean(axis=0, keepdims=True), owners, 0) for each in draws]
    shares = [np.mean([low <= 0 <= high for low, high in filter(None, kept)]) for kept in (both, subjects_alone)]
    assert least <= shares[0] <= most and shares[1] < 0.75 * shares[0], shares


def test_the_variance_of_seeds_is_added_to_that_of_subjects() -> None:
    """Var = that of the mean over seeds by subjects, and the seeds' variance over their number, in closed form."""
    rng = np.random.default_rng(5)
    subjects = np.repeat(np.arange(6), 5)
    values = rng.normal(size=30) + subjects + np.array([[0.0], [1.0], [4.0]])
    of_subjects = np.var(bootstrap(values.mean(axis=0, keepdims=True), subjects, 0))
    draws = np.concatenate([over_seeds(bootstrap(values, subjects, seed), seed) for seed in range(20)])
    assert np.var(draws) == pytest.approx(of_subjects + np.var([0, 1, 4]) / 3, rel=0.05)


def test_a_paired_difference_sees_what_two_intervals_hide() -> None:
    rng = np.random.default_rng(0)
    subjects = np.repeat(np.arange(8), 6)
    base = rng.normal(30, 3, 8)[subjects][None] + rng.normal(size=(2, 48))
    better = base + 0.2 + rng.normal(0, 0.05, size=(2, 48))
    (found,) = differences([(better, base)], subjects, 0)
    assert found is not None and found.separated and found.low is not None and found.high is not None
    assert found.low < 0.2 < found.high < 0.3
    assert (found.paired, found.subjects) == (96, 8)
    assert found.p == pytest.approx(2 / 2**8) and found.spread is not None and found.spread < 0.02
    overlap = [_interval(values, subjects) for values in (base, better)]
    assert overlap[0][1] > overlap[1][0]


def test_only_what_both_have_is_paired() -> None:
    subjects = np.array([0, 0, 1, 1])
    first = np.array([[1.0, NAN, 3.0, 4.0]])
    second = np.array([[0.0, 5.0, 1.0, NAN]])
    found, nothing = differences([(first, second), (first, np.full((1, 4), NAN))], subjects, 0)
    assert found is not None and nothing is None
    assert (found.value, found.paired, found.subjects) == (1.5, 2, 2)  # subject 0: 1, subject 1: 2
    (means,) = differences([(np.array([[1.0, 1, 1, 1], [3, 3, 3, 3]]), np.zeros((1, 4)))], subjects, 0, tested=False)
    assert means is not None and means.value == 2.0 and means.p is None


def test_no_difference_at_all_is_never_separated() -> None:
    values = np.random.default_rng(0).normal(size=(1, 12))
    (found,) = differences([(values, values)], np.repeat(np.arange(4), 3), 0)
    assert found == Difference(0.0, 0.0, 0.0, 12, 4, None, 1.0, 1.0) and not found.separated


def test_sign_flips_are_exact_with_few_subjects() -> None:
    """All choices of signs by hand."""
    apart = np.array([[0.5, 1.0, -0.2, 2.0, 0.7], [1.0, 1.0, 1.0, 1.0, 1.0]])
    for row, p in zip(apart, sign_flips(apart, 0), strict=True):
        flipped = [abs(np.mean(np.array(signs) * row)) for signs in product((-1, 1), repeat=5)]
        assert p == pytest.approx(np.mean(np.array(flipped) >= abs(row.mean()) - 1e-12))
    assert sign_flips(apart, 0)[1] == least_p(5) == 2 / 32
    assert sign_flips(np.array([[3.0, NAN, NAN]]), 0)[0] == least_p(1) == 1.0


def test_sign_flips_agree_with_the_t_test_where_that_holds() -> None:
    apart = np.random.default_rng(4).normal(0.4, 1, size=(1, 30))
    assert sign_flips(apart, 0)[0] == pytest.approx(stats.ttest_1samp(apart[0], 0).pvalue, abs=0.01)


def test_holm_by_hand() -> None:
    """Four p-values: 4 * .005, max(., 3 * .01), then 2 * .03 and 1 * .04 raised to it."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.7]) == [1.0, 1.0] and holm([]) == []


@given(st.lists(st.floats(0, 1), min_size=1, max_size=8))
def test_holm_lies_between_no_correction_and_bonferroni(p: list[float]) -> None:
    adjusted = holm(p)
    assert all(raw <= found <= min(1.0, raw * len(p)) + 1e-12 for raw, found in zip(p, adjusted, strict=True))
    # Benjamini-Hochberg promises less, so it never asks for more.
    assert all(np.array(adjusted) >= stats.false_discovery_control(p) - 1e-12)
    order = np.argsort(p, kind="stable")
    assert all(np.diff(np.array(adjusted)[order]) >= 0)


def test_correction_is_over_the_family_alone() -> None:
    told = [Difference(1.0, None, None, 4, 2, None, p, p) for p in (0.01, 0.02, 0.5)]
    found = corrected([*told, None], [True, False, True, True])
    assert [each.adjusted for each in found if each] == [0.02, 0.02, 0.5]
    assert [each.adjusted for each in corrected(told) if each] == pytest.approx([0.03, 0.04, 0.5])


def test_a_time_ratio_with_its_noise() -> None:
    rng = np.random.default_rng(0)
    before = [list(rng.lognormal(np.log(scale), 0.1, 12)) for scale in (4, 5, 9, 30)]
    slower = [list(1.3 * rng.lognormal(np.log(scale), 0.1, 12)) for scale in (4, 5, 9, 30)]
    ratio, low, high = time_ratio(slower, before, 0)
    assert low is not None and high is not None and 1 < low < ratio < high
    assert ratio == pytest.approx(1.3, abs=0.1)
    same, low, high = time_ratio(before, before, 0)
    assert low is not None and high is not None and low < same == 1.0 < high
    assert time_ratio([[4.0]], [[2.0]], 0) == (pytest.approx(2.0), None, None)


def test_cells_that_disagree_widen_the_interval_of_a_time_ratio() -> None:
    """Without noise in their repeats: two cells take twice as long, two half."""
    before = [[4.0] * 8] * 4
    ratio, low, high = time_ratio([[8.0] * 8, [2.0] * 8, [8.0] * 8, [2.0] * 8], before, 0)
    assert low is not None and high is not None
    assert (ratio, low, high) == (pytest.approx(1.0), pytest.approx(0.5), pytest.approx(2.0))
