"""The pictures of a run: those that were timed are those that were scored, and both come out again."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...bench import given
from ...bench.isolation import isolated
from ...bench.lending import answered
from ...bench.reopening import method_as
from ...device import device_name
from ...errors import Changed
from ...evenly import evenly
from ...registry import METHODS
from ...results.record import CellRecord
from ...scene import Array, Prediction
from .evidence import Evidence, scored_queries
from .records import verdict_on

HALF = 2.0**-11
"""Half a unit in the last place of a half float, relative; below 2**-14 it is 2**-25."""

_SAME = 1e-5  # of the brightest pixel: what sums in another order may leave, as in `cell`
_REDRAWN = 3  # queries of a cell that are drawn again
_RESCORED = 4  # queries of a cell that are scored again
_PATIENCE = 20.0  # seconds that personalising took, above which a cell is not done again
_NOISE, _BEYOND = 3, 6.0  # draws of rounding noise, and how many times beyond their effect a score may lie


def timed(evidence: Evidence) -> tuple[bool | None, str]:
    """In each cell the pictures drawn for the clock were those that were scored, as the run itself compared them."""
    different = [cell.label for cell in evidence.cells if cell.same_pixels is False]
    compared = sum(cell.same_pixels is not None for cell in evidence.cells)
    if different:
        return verdict_on([f"{cell} drew other pixels when timed again" for cell in different], "")
    if not compared:
        return None, "no cell drew a picture twice"
    return True, f"{compared} of {len(evidence.cells)} cells drew pictures twice, all alike"


def redrawn(evidence: Evidence) -> tuple[bool | None, str]:
    """Methods loaded from their kept trainings draw the kept pictures again, up to the rounding of half floats."""
    trouble: list[str] = []
    left_out, worst, count = [], 0.0, 0
    for cell in evidence.cells:
        if why := _not_done_again(evidence, cell):
            left_out.append(f"{cell.method.name} ({why})")
            continue
        for key, drawn in _drawn(evidence, cell, trouble).items():
            count += 1
            apart = _beyond_half(drawn, evidence.kept(cell, key))
            worst = max(worst, apart)
            if apart > 1.0:
                trouble.append(f"{cell.label} draws {key} differently ({apart:.1f} times what rounding explains)")
    note = f"; left out: {', '.join(dict.fromkeys(left_out))}" if left_out else ""
    if trouble:
        return verdict_on(trouble, "")
    if not count:
        return None, "nothing could be drawn again" + note
    return True, f"{count} pictures, at most {worst:.2f} of what half floats and {_SAME:.0e} of the peak explain{note}"


def _drawn(evidence: Evidence, cell: CellRecord, trouble: list[str]) -> dict[str, Prediction]:
    """Pictures of a cell drawn again, by query. A method that changes what it is given is a trouble, and no other's."""
    lender = evidence.bench.lender
    with isolated():
        bench = replace(evidence.bench, selected=lender.lend(evidence.selected, cell.method.name))
        method = method_as(METHODS.entry(cell.method.name), cell.method.preset, cell.method.config)
        prior = method.load(evidence.store.sound_state(cell.prior or ""))
        avatar = prior.personalise(bench.enrolment(cell.subject, method), cell.seed)
        queries = {f.key: given.asked(bench.selected, method.info, f) for _, f in bench.scored(cell.subject)}
        chosen = evenly(scored_queries(cell), _REDRAWN)
        drawn = {key: answered(avatar.relight(queries[key])) for key in chosen}
    try:
        lender.check()
    except Changed as changed:
        trouble.append(f"{cell.label} changed what it was given: {changed}")
    return drawn


def _not_done_again(evidence: Evidence, cell: CellRecord) -> str:
    """Why a cell is not drawn again, or ""."""
    if cell.method.name in evidence.foreign:
        return "not registered here"
    if not scored_queries(cell):
        return "no pictures"
    if cell.prior is None or evidence.store.read_prior(cell.prior) is None:
        return "its training is not kept"
    if (cell.times.personalise_s or 0.0) > _PATIENCE:
        return f"personalises for {cell.times.personalise_s:.0f} s"
    if cell.device is None or cell.device.networks != device_name():
        return f"drawn on {cell.device.networks if cell.device else 'an unknown device'}"
    return ""


def _beyond_half(drawn: Prediction, kept: Prediction) -> float:
    """The greatest difference of two pictures, in units of what rounding to half floats explains; inf for NaN."""
    worst = 0.0
    for new, old in ((drawn.image, kept.image), (drawn.alpha, kept.alpha)):
        if new.shape != old.shape or not np.isfinite(new).all():
            return math.inf
        allowed = half_ulp(new) + _SAME * max(float(np.abs(new).max()), 1e-6)
        worst = max(worst, float((np.abs(np.clip(new, -65504.0, 65504.0) - old) / allowed).max()))
    return worst


def half_ulp(image: Array) -> Array:
    """How far the nearest half float may be, elementwise."""
    return np.maximum(np.abs(image) * HALF, 2.0**-25)


@dataclass(frozen=True)
class _Again:
    """A score computed again from a kept picture, and how much the rounding of the picture moves it."""

    value: float
    noise: float


def rescored(evidence: Evidence) -> tuple[bool | None, str]:
    """Scores of the kept pictures are the stored ones, up to what rounding the picture to half floats does to them.

    How much that is is measured: pictures that rounding might have made each of (`_unrounded`) are scored as well, and
    the stored score must lie within `_BEYOND` times the greatest change and half of the last digit that tables print.
    Rows with the truth in hand are left to "oracle perfect": near a perfect score rounding is all there is.
    """
    trouble, skipped, worst, count = [], set(), 0.0, 0
    for number, cell in enumerate(evidence.cells):
        if cell.method.truth or not cell.predictions:
            continue
        rng = np.random.default_rng([29, number])
        stored = {(frame.query, signature): value for frame, signature, value, _ in cell.each()}
        for key in evenly(scored_queries(cell), _RESCORED):
            for signature, again in _again(evidence, cell, key, rng).items():
                value = stored.get((key, signature))
                if isinstance(again, str):  # no value: told by coverage, unless the store has one
                    if value is not None:
                        skipped.add(f"{evidence.metrics[signature].title} ({again})")
                    continue
                shown = 0.5 * 10.0 ** -evidence.metrics[signature].decimals
                allowed = _BEYOND * again.noise + shown
                apart = math.inf if value is None else abs(value - again.value) / allowed
                worst, count = max(worst, apart), count + 1
                if apart > 1.0:
                    kept = "no value" if value is None else f"{value:.6g}"
                    title = evidence.metrics[signature].title
                    trouble.append(
                        f"{cell.label}: {title} of {key} is stored as {kept}, its picture gives {again.value:.6g}"
                    )
    if trouble:
        return verdict_on(trouble, "")
    if not count:
        return None, "no kept pictures to score"
    note = f"; not told by pictures: {', '.join(sorted(skipped))}" if skipped else ""
    return True, f"{count} scores, at most {worst:.2f} of what half floats and print explain{note}"


def _again(evidence: Evidence, cell: CellRecord, key: str, rng: np.random.Generator) -> dict[str, _Again | str]:
    """By signature the score of a kept picture, or the reason why it has none."""
    frame, kept = evidence.frames[key], evidence.kept(cell, key)
    pairs = [evidence.pair(frame, picture) for picture in (kept, *_unrounded(kept, rng))]
    found: dict[str, _Again | str] = {}
    for signature, metric in evidence.metrics.items():
        scores = metric(pairs)
        values = [score.value for score in scores if score.value is not None]
        if len(values) < len(scores):
            found[signature] = next(score.reason for score in scores if score.reason is not None)
        else:
            found[signature] = _Again(values[0], max(abs(value - values[0]) for value in values[1:]))
    return found


def _unrounded(kept: Prediction, rng: np.random.Generator) -> Iterator[Prediction]:
    """Pictures that rounding to half floats might have made the kept one of.

    Some with noise, and two whose alpha is all that it can be more, or less: silhouettes are cut at a threshold, and
    noise may happen to leave a pixel on its side of it.
    """
    for _ in range(_NOISE):
        image, alpha = (a + half_ulp(a) * rng.uniform(-1.0, 1.0, a.shape) for a in (kept.image, kept.alpha))
        yield Prediction(image, alpha)
    for sign in (-1.0, 1.0):
        yield Prediction(kept.image, kept.alpha + sign * half_ulp(kept.alpha))
