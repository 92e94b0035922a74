"""May a candidate run replace a baseline run? Quality and times of the methods that both measured.

A regression needs both: an effect beyond its threshold, and a 95 % interval that excludes no effect. A pass needs
intervals that exclude the threshold: where one does not, the runs are too noisy to tell. What cannot be compared is
said, never guessed: another protocol, other data or seeds, another coverage, another device for times.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from statistics import median

import numpy as np

from ..errors import InputError, unknown_name
from ..scene import TIMED_KINDS
from .measured import Spread
from .origin import Hardware
from .outcome import Check, Outcome, Verdict
from .reading import Run, mismatch
from .record import UNEQUAL, CellRecord, MetricRecord
from .statistics import aggregate, differences, time_ratio
from .values import Values, values_of

TIMES = {"new_pose_ms": "new pose", "known_pose_ms": "known pose, new light"}  # of a frame; compared with their spread
_SEED = 0  # of the bootstrap


@dataclass(frozen=True)
class Quality:
    """How much worse a metric may be: a share of the baseline's value, or an amount for single metrics by name.

    What does not show in the metric's printed decimals is never too much.
    """

    share: float = 0.01
    amounts: dict[str, float] = field(default_factory=dict)

    def allowed(self, metric: MetricRecord, value: float) -> float:
        shown = 0.5 * 10.0**-metric.decimals
        return max(self.amounts.get(metric.name, self.share * abs(value)), shown)


def gate(
    candidate: Run,
    baseline: Run,
    quality: Quality,
    time: float | None,
    time_asked: bool = False,
    methods: Sequence[str] | None = None,
    memory: float | None = None,
) -> Outcome:
    """Compare a candidate run with a baseline.

    quality     how much worse a metric may be
    time        how much longer a frame may take, as a share; None compares no times
    time_asked  other devices make the runs not comparable; otherwise times are then left out, with a remark
    memory      how much more memory drawing may take, as a share, on the same device; None compares none
    methods     to compare; None: all measured methods of the baseline (no calibration rows)

    Raises `InputError` for a method that the baseline does not have and an amount for a metric that it does not have.
    """
    if why := mismatch(baseline, candidate):
        return Outcome(Verdict.NOT_COMPARABLE, reasons=(why,))
    chosen = _methods(baseline, methods)
    known = [metric.name for metric in baseline.plan.protocol.metrics]
    for name in quality.amounts:
        if name not in known:
            raise unknown_name(f"metric of {baseline.protocol}", name, known)
    new, old = (_Side(run, values_of(run)) for run in (candidate, baseline))
    if failed := tuple(new.failures()):
        return Outcome(Verdict.FAILED, reasons=failed)
    if reasons := tuple(_incomparable(new, old, chosen)):
        return Outcome(Verdict.NOT_COMPARABLE, reasons=reasons)
    checks = list(_qualities(new, old, chosen, quality))
    remarks = list(_remarks(new, old, chosen))
    for what, allowed, asked in (("times", time, time_asked), ("memory", memory, True)):
        if allowed is None:
            continue
        costs = list((_times if what == "times" else _memory)(new, old, chosen, allowed))
        gaps = [method for method in chosen if method not in {check.method for check in costs}]
        why = f"{what} of different devices: {why}" if (why := _other_device(new, old, chosen)) else ""
        if not why and not costs:
            why = f"no {what} of {', '.join(gaps)} in both runs"
        if why and asked:
            return Outcome(Verdict.NOT_COMPARABLE, reasons=(why,))
        if why:
            remarks.append(f"Not compared: {why}.")
            continue
        checks += costs
        if gaps:
            remarks.append(f"Not compared: no {what} of {', '.join(gaps)} in both runs.")
    unequal = {name for name in chosen if new.run.plan.method(name).enrolled_unlike(old.run.plan.method(name))}
    checks = [replace(check, unequal=check.method in unequal) for check in checks]
    found = {check.verdict for check in checks}
    noisy = Verdict.TOO_NOISY if "cannot tell" in found else Verdict.PASS
    verdict = Verdict.REGRESSION if "regression" in found else noisy
    return Outcome(verdict, tuple(checks), remarks=tuple(remarks))


@dataclass(frozen=True)
class _Side:
    """One of the two runs."""

    run: Run
    values: dict[tuple[str, str], Values]

    def of(self, method: str) -> dict[tuple[int, str], CellRecord]:
        """The cells of a method by seed and subject."""
        return {(cell.seed, cell.subject): cell for cell in self.run.in_order if cell.method.name == method}

    def failures(self) -> Iterator[str]:
        planned, cells = len(self.run.plan.cells), self.run.in_order
        if missing := planned - len(cells):
            yield f"{missing} of {planned} cells of {self.run.folder} are not computed"
        for cell in cells:
            if cell.error is not None:
                last = (cell.error.strip().splitlines() or ["without a word"])[-1]
                yield f"{cell.label} crashed ({last})"

    @property
    def names(self) -> list[str]:
        return [method.name for method in self.run.plan.methods]


def _methods(baseline: Run, methods: Sequence[str] | None) -> list[str]:
    known = [method.name for method in baseline.plan.methods]
    for name in methods or ():
        if name not in known:
            raise unknown_name(f"method of {baseline.folder}", name, known)
    measured = [method.name for method in baseline.plan.methods if not method.calibration]
    if not methods and not measured:
        raise InputError(f"{baseline.folder} holds calibration rows only; name methods to compare with --methods")
    return list(methods or measured)


def _incomparable(new: _Side, old: _Side, methods: Sequence[str]) -> Iterator[str]:
    """Other seeds, a method that is gone, other coverage."""
    for method in methods:
        seeds = [sorted(side.run.plan.seeds_for(method)) for side in (new, old)]
        if seeds[0] != seeds[1] and method in new.names:
            yield f"the seeds of {method} differ: {new.run.folder} has {seeds[0]}, {old.run.folder} has {seeds[1]}"
            continue
        if method not in new.names:
            yield f"{new.run.folder} has no method {method!r}, which {old.run.folder} has"
            continue
        for column in new.run.plan.protocol.columns:
            ours, theirs = (side.values[method, column.name] for side in (new, old))
            counts = [int(np.isfinite(side.values).sum()) for side in (ours, theirs)]
            if not np.array_equal(np.isfinite(ours.values), np.isfinite(theirs.values)):
                why = next((reason for reasons in (*ours.reasons, *theirs.reasons) for reason in reasons), "")
                yield (
                    f"the coverage of {method} in column {column.name!r} differs: {counts[0]} of "
                    f"{ours.values.size} values in {new.run.folder}, {counts[1]} in {old.run.folder} ({why})"
                )


def _qualities(new: _Side, old: _Side, methods: Sequence[str], quality: Quality) -> Iterator[Check]:
    protocol = old.run.plan.protocol
    for column in protocol.columns:
        sides = [(new.values[method, column.name], old.values[method, column.name]) for method in methods]
        for place, metric in enumerate(protocol.metrics):
            wrong = -1.0 if metric.higher_is_better else 1.0
            pairs = [(wrong * ours.values[place], wrong * theirs.values[place]) for ours, theirs in sides]
            apart = differences(pairs, sides[0][0].subjects, _SEED, tested=False)
            for method, both, each in zip(methods, sides, apart, strict=True):
                after, before = (aggregate(side.values[place], side.subjects) for side in both)
                if each is not None and after is not None and before is not None:
                    allowed = quality.allowed(metric, before)
                    verdict = _verdict(each.value, each.low, each.high, allowed)
                    told = (method, column.title, metric.title, before, after)
                    yield Check(*told, each.value, each.low, each.high, allowed, verdict, "quality")


def _times(new: _Side, old: _Side, methods: Sequence[str], allowed: float) -> Iterator[Check]:
    for method in methods:
        earlier = old.of(method)
        for (name, title), kind in product(TIMES.items(), TIMED_KINDS):
            title = f"{title}, {kind}, ms"
            found = [(cell, earlier[place]) for place, cell in new.of(method).items() if place in earlier]
            pairs = [tuple(getattr(cell.times, name).get(kind) for cell in both) for both in found]
            measured = [pair for pair in pairs if all(pair)]
            if measured:
                ours, theirs = zip(*measured, strict=True)
                ratio, low, high = time_ratio(_repeats(ours), _repeats(theirs), _SEED)
                low, high = (None if bound is None else bound - 1 for bound in (low, high))
                verdict = _verdict(ratio - 1, low, high, allowed)
                before, after = (median(spread.median for spread in side) for side in (theirs, ours))
                yield Check(method, "", title, before, after, ratio - 1, low, high, allowed, verdict, "time")


def _memory(new: _Side, old: _Side, methods: Sequence[str], allowed: float) -> Iterator[Check]:
    """The greatest resident memory while drawing; cells are its repeats."""
    for method in methods:
        earlier = old.of(method)
        found = [
            (cell.cost.peak_mb, earlier[place].cost.peak_mb)
            for place, cell in new.of(method).items()
            if place in earlier
        ]
        pairs = [(after, before) for after, before in found if after and before]
        if pairs:
            ours, theirs = zip(*pairs, strict=True)
            ratio, low, high = time_ratio([[each] for each in ours], [[each] for each in theirs], _SEED)
            low, high = (None if bound is None else bound - 1 for bound in (low, high))
            told = (method, "", "greatest memory, MiB", median(theirs), median(ours), ratio - 1, low, high, allowed)
            yield Check(*told, _verdict(ratio - 1, low, high, allowed), "memory")


def _repeats(spreads: Sequence[Spread]) -> list[list[float]]:
    """The repeats of each cell; the median alone where a run did not keep them."""
    return [list(spread.values or (spread.median,)) for spread in spreads]


def _verdict(worse: float, low: float | None, high: float | None, allowed: float) -> str:
    """Without an interval only no difference at all can be told, and a gain cannot."""
    if low is None or high is None:
        return "same" if worse == 0 else "cannot tell"
    certain = low > 0 or high < 0
    if worse > allowed and certain:
        return "regression"
    if high > allowed:
        return "cannot tell"
    if not certain:
        return "same"
    return "worse" if worse > 0 else "better"


def _other_device(new: _Side, old: _Side, methods: Sequence[str]) -> str | None:
    """Which devices the two runs used for a method, if they are not one.

    Methods are asked one by one: one that never loads torch does not tell what torch knows of the machine.
    """
    for method in methods:
        used = [sorted({_device(cell.device) for cell in side.of(method).values()}) for side in (new, old)]
        if used[0] != used[1] or len(used[0]) != 1:
            sides = zip((new, old), used, strict=True)
            return ", ".join(f"{side.run.folder} on {' and '.join(devices)}" for side, devices in sides)
    return None


def _device(device: Hardware | None) -> str:
    if device is None:
        return "an unknown device"
    parts = [device.cpu, f"{device.cores} cores", f"{device.threads} threads", *device.gpus]
    return ", ".join([*parts, f"networks on {device.networks}"] if device.networks else parts)


def _remarks(new: _Side, old: _Side, methods: Sequence[str]) -> Iterator[str]:
    for method in methods:
        presets = [side.run.plan.method(method).preset for side in (new, old)]
        if presets[0] != presets[1]:
            yield f"{method} has another preset: {presets[0]!r}, the baseline {presets[1]!r}."
        ours, theirs = (side.run.plan.method(method) for side in (new, old))
        if ours.enrolled_unlike(theirs):
            yield f"{UNEQUAL} Enrolment gave {method} {ours.enrolment!r}, the baseline {theirs.enrolment!r}."
    if more := [name for name in new.names if name not in old.names]:
        yield f"Not in the baseline, so not compared: {', '.join(more)}."
