"""What the gate found: every comparison, the verdict, and the sentence that tells it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum


class Verdict(IntEnum):
    """The exit code of `handbench gate`."""

    PASS = 0
    REGRESSION = 1
    NOT_COMPARABLE = 2
    FAILED = 3
    TOO_NOISY = 4


@dataclass(frozen=True)
class Check:
    """One comparison. `worse` is how far the candidate is on the wrong side, with its interval, in the unit of
    `allowed`; for times and memory the factor minus one. verdict: "regression"; "cannot tell" (it may be beyond what
    is allowed, and may be noise); "worse" (beyond noise but allowed), "same" or "better". unequal: enrolment gave the
    candidate something else than the baseline."""

    method: str
    column: str
    metric: str
    baseline: float
    candidate: float
    worse: float
    low: float | None
    high: float | None
    allowed: float
    verdict: str
    kind: str
    unequal: bool = False


@dataclass(frozen=True)
class Outcome:
    """What the gate found; `reasons` say why there is nothing to compare, or what failed."""

    verdict: Verdict
    checks: tuple[Check, ...] = ()
    reasons: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def regressions(self) -> tuple[Check, ...]:
        return tuple(check for check in self.checks if check.verdict == "regression")

    @property
    def noisy(self) -> tuple[Check, ...]:
        return tuple(check for check in self.checks if check.verdict == "cannot tell")

    @property
    def sentence(self) -> str:
        """The outcome in one sentence."""
        if self.verdict is Verdict.NOT_COMPARABLE:
            return f"not comparable: {'; '.join(self.reasons)}"
        if self.verdict is Verdict.FAILED:
            return f"the candidate run failed: {'; '.join(self.reasons)}"
        count = len(self.checks)
        if self.verdict is Verdict.PASS:
            return f"pass: none of {count} comparisons is a regression"
        if self.verdict is Verdict.TOO_NOISY:
            return (
                f"too noisy to tell: {_share(self.noisy, count)}, may be worse than is allowed; more subjects, frames, "
                "seeds or repeats tell, or a wider threshold"
            )
        return f"regression: {_share(self.regressions, count)}"


def _share(checks: Sequence[Check], count: int) -> str:
    """ "2 of 12 comparisons, in good"."""
    methods = ", ".join(dict.fromkeys(check.method for check in checks))
    return f"{len(checks)} of {count} comparisons, in {methods}"
