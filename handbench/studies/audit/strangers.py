"""Whether a scored person is also in another capture, on which a prior may have been trained."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...scene import Array
from .evidence import Evidence
from .records import verdict_on

_SAME = 1e-9  # between shapes of one person


def strangers(evidence: Evidence) -> tuple[bool | None, str]:
    """No scored subject is a person of another open capture, by name and by the true shape where it is told."""
    from ...data.openstage.population import PEOPLE, people_of_others

    protocol, capture = evidence.protocol, evidence.capture
    if protocol.capture not in PEOPLE:
        return None, f"{protocol.capture} is none of the captures that share people"
    firsts = {frame.subject: frame for frame in reversed(tuple(evidence.frames.values()))}
    shapes = {subject: capture.truth(firsts[subject]).shape for subject in protocol.subjects}
    trouble, count = [], 0
    for other, person in people_of_others(protocol.capture):
        count += 1
        same = [name for name, shape in shapes.items() if name == person.name or _same(shape, person.identity)]
        trouble += [f"{name} is {person.name} of {other}, which methods may train on" for name in same]
    return verdict_on(trouble, f"{len(shapes)} scored subjects are none of the {count} people of other captures")


def _same(shape: Array | None, other: Any) -> bool:
    return shape is not None and float(np.abs(shape - np.asarray(other)).max()) < _SAME
