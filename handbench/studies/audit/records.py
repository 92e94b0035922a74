"""What the files of a run say of themselves: all that was planned is there, once, and where it comes from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from ...errors import InputError
from ...results.fieldtypes import at
from .evidence import Evidence

_TOLD = ("version", "python", "packages", "os", "device", "command", "started")  # git is none of an installed copy


def coverage(evidence: Evidence) -> tuple[bool, str]:
    """Every planned cell is there, with one score for each of its queries and metrics, which is a value or a reason."""
    plan = evidence.plan
    there = {cell.key for cell in evidence.cells}
    trouble = [f"cell {key[:12]} is missing" for key in plan.cells if key not in there]
    signatures = [metric.signature for metric in plan.protocol.metrics]
    queries = {column.name: column.queries for column in plan.protocol.columns}
    if queries != {name: tuple(frame.key for frame in frames) for name, frames in evidence.selected.scored.items()}:
        trouble.append("run.json names other queries than the protocol selects")
    count = 0
    for cell in evidence.cells:
        owed = Counter(
            (column, query, signature)
            for column, of_column in queries.items()
            for query in of_column
            if evidence.frames[query].subject == cell.subject
            for signature in signatures
        )
        found = Counter((frame.column, frame.query, signature) for frame, signature, *_ in cell.each())
        count += sum(found.values())
        for what, difference in (("lacks", owed - found), ("has too many", found - owed)):
            if difference:
                trouble.append(f"{cell.label} {what} scores, e.g. {' '.join(next(iter(difference)))}")
    return verdict_on(trouble, f"{len(plan.cells)} cells, {count} scores: each once, a value or a reason")


def keys(evidence: Evidence) -> tuple[bool | None, str]:
    """Each cell's key is what this code computes for its method, preset, data, protocol, subject and seed."""
    wanted = {(cell.method, cell.subject, cell.seed): cell for plan in evidence.planned.values() for cell in plan.cells}
    other, trouble = 0, []
    cells = [cell for cell in evidence.cells if cell.method.name not in evidence.foreign]
    for cell in cells:
        planned = wanted.get((cell.method.name, cell.subject, cell.seed))
        if planned is None:
            trouble.append(f"{cell.label} is not of the run's methods, subjects and seeds")
        elif (planned.key, planned.prior) != (cell.key, cell.prior):
            other += 1
    if trouble:
        return verdict_on(trouble, "")
    if other:
        return False, (
            f"{other} of {len(cells)} cells were computed with other code, packages or settings than those "
            "here; audit with the version that run.json names, or run again"
        )
    note = f"; not registered here: {', '.join(sorted(evidence.foreign))}" if evidence.foreign else ""
    if not cells:
        return None, "no method of the run is registered here"
    return True, f"all {len(cells)} come out again from source, settings, data, protocol and seed{note}"


def signatures(evidence: Evidence) -> tuple[bool, str]:
    """Each metric's signature is one that this version writes, and scores carry no other."""
    from ...metrics import from_signature

    trouble, known = [], []
    for metric in evidence.plan.protocol.metrics:
        known.append(metric.signature)
        try:
            from_signature(metric.signature)
        except InputError as error:
            trouble.append(str(error))
    for cell in evidence.cells:
        for signature in set(cell.metrics) - set(known):
            trouble.append(f"{cell.label} has scores of {signature!r}, which run.json does not name")
    return verdict_on(trouble, f"all {len(known)} are known to this version")


def provenance(evidence: Evidence) -> tuple[bool, str]:
    """The run and each cell say version, commit, packages, machine, command and when; a cell its configuration."""
    trouble, dirty = [], 0
    for owner, record in (("run.json", evidence.plan), *((cell.label, cell) for cell in evidence.cells)):
        lacking = [name for name in _TOLD if not at(record, f"provenance.{name}")]
        if lacking:
            trouble.append(f"{owner} does not tell its {', '.join(lacking)}")
    for cell in evidence.cells:
        dirty += bool(at(cell, "provenance.git.dirty"))
        if cell.method.config is None or cell.device is None:
            trouble.append(f"{cell.label} does not tell its configuration and device")
    note = f"; {dirty} cells come from a checkout with uncommitted changes" if dirty else ""
    return verdict_on(trouble, f"complete in run.json and {len(evidence.cells)} cells{note}")


def verdict_on(trouble: Iterable[str], fine: str) -> tuple[bool, str]:
    """The verdict of a list of troubles: the first two are told, the others counted."""
    trouble = list(dict.fromkeys(trouble))
    if not trouble:
        return True, fine
    rest = f"; and {len(trouble) - 2} more" if len(trouble) > 2 else ""
    return False, "; ".join(trouble[:2]) + rest
