"""Flicker: the temporal difference of the error, written out with numpy and as dtSSD's absolute sibling."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from handbench.metrics import Pair
from handbench.metrics.geometry.flicker import FLICKER, flicker
from handbench.scene.colour import srgb

SIZE = (9, 7)
MASK = np.ones(SIZE)


def sequence(predictions: np.ndarray, truths: np.ndarray, masks: np.ndarray | None = None) -> list[Pair]:
    masks = np.broadcast_to(MASK, (len(truths), *SIZE)) if masks is None else masks
    return [Pair(p, t, m) for p, t, m in zip(predictions, truths, masks, strict=True)]


def frames(seed: int, count: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Pictures (count, H, W, 3) that leave [0, 1] on both sides."""
    return tuple(np.random.default_rng(seed).normal(0.5, 0.4, (2, count, *SIZE, 3)))  # type: ignore[return-value]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_it_is_the_mean_temporal_difference_of_the_error(seed: int) -> None:
    predictions, truths = frames(seed)
    error = srgb(predictions) - srgb(truths)
    changes = signal.fftconvolve(error, np.array([1.0, -1.0]).reshape(2, 1, 1, 1), mode="valid", axes=0)
    assert flicker(sequence(predictions, truths)).value == pytest.approx(np.abs(changes).mean())


def test_what_is_steady_scores_zero() -> None:
    predictions, truths = frames(1)
    assert flicker(sequence(truths, truths)).value == FLICKER.perfect == 0.0
    still = np.broadcast_to(predictions[0], predictions.shape)
    wrong = np.broadcast_to(truths[0], truths.shape)
    assert flicker(sequence(still, wrong)).value == 0.0  # wrong in the same way all the time
    assert flicker(sequence(still, truths)).value > 0.1  # it does not follow the truth


def test_an_alternating_error_counts_twice_and_order_matters() -> None:
    """In display values 0.5 ± 0.1, as the square root of a middle grey would be."""
    grey = lambda display: np.full((*SIZE, 3), ((display + 0.055) / 1.055) ** 2.4)  # noqa: E731
    truths = np.stack([grey(0.5)] * 4)
    alternating = sequence(np.stack([grey(0.6), grey(0.4), grey(0.6), grey(0.4)]), truths)
    assert flicker(alternating).value == pytest.approx(0.2)
    sorted_ = sequence(np.stack([grey(0.6), grey(0.6), grey(0.4), grey(0.4)]), truths)
    assert flicker(sorted_).value == pytest.approx(0.2 / 3)


def test_only_pixels_in_both_masks_count() -> None:
    predictions, truths = frames(2, 3)
    masks = np.zeros((3, *SIZE))
    masks[0, 2:6, 1:5] = masks[1, 3:7, 1:5] = 1.0  # the last frame shows no hand
    noisy = predictions.copy()
    noisy[:, :3] = 7.0
    noisy[2] = -3.0
    assert flicker(sequence(noisy, truths, masks)) == flicker(sequence(predictions, truths, masks))
    assert (
        flicker(sequence(predictions, truths, 0 * masks)).reason == "no pixel has alpha > 0.5 in two consecutive frames"
    )


def test_why_there_is_no_score() -> None:
    predictions, truths = frames(3)
    assert flicker([]).reason == "a sequence needs two frames or more, this one has 0"
    assert (
        flicker(sequence(predictions[:1], truths[:1])).reason == "a sequence needs two frames or more, this one has 1"
    )
    predictions[1, 2, 3, 0] = np.nan
    assert flicker(sequence(predictions, truths)).reason == "non-finite prediction: 1 value"
    small = Pair(truths[0, :4], truths[0, :4], MASK[:4])
    assert "differ in size: (4, 7), (9, 7)" in flicker([small, *sequence(truths, truths)]).reason


def test_the_signature() -> None:
    assert FLICKER.signature == "flicker|region:both-alpha>0.5|space:srgb|order:given|power:1|motion:none|v1"
    assert (FLICKER.latex, FLICKER.higher_is_better) == (r"Flicker$\downarrow$", False)
