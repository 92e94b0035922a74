"""Doubt about a finished run, check by check: what it claims is computed again, from other sides, and compared.

evidence.py      the run, and the protocol and capture that it names
records.py       coverage, keys, signatures, provenance: what the files say
calibration.py   the oracle above and the mean predictor below
separation.py    what training saw and what is scored; strangers.py: people of other captures
pixels.py        pictures drawn again, scores computed again
order.py         nothing depends on the order of images or of shards
injection.py     NaN put in at every stage must show
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ...bench.check import Finding
from ...bench.failure import failure
from . import calibration, injection, order, pixels, records, separation, strangers
from .evidence import Check, Evidence, Tables, gather

__all__ = ["Finding", "audit"]

CHECKS: dict[str, Check] = {
    "coverage": records.coverage,
    "keys": records.keys,
    "signatures": records.signatures,
    "provenance": records.provenance,
    "oracle perfect": calibration.oracle,
    "mean is the floor": calibration.floor,
    "train and test apart": separation.apart,
    "strangers": strangers.strangers,
    "timed are scored": pixels.timed,
    "drawn again": pixels.redrawn,
    "scored again": pixels.rescored,
    "image order": order.images,
    "shard order": order.shards,
    **{f"NaN in {stage.name}": stage.check for stage in injection.STAGES},
}


def audit(run_folder: Path, tables: Tables, protocol: str | None = None, data: Path | None = None) -> Iterator[Finding]:
    """One verdict a check of `CHECKS`, as they are done; `tables` makes the table of a run folder.

    `protocol` names the run's protocol file if it is not a registered one; `data` is where captures are kept. Nothing
    in the run folder is changed. Raises `InputError` for a folder without a readable run, and for a protocol or a
    capture that is not the run's.
    """
    evidence = gather(run_folder, tables, protocol, data)
    for name, check in CHECKS.items():
        yield _tried(name, check, evidence)


def _tried(name: str, check: Check, evidence: Evidence) -> Finding:
    """The verdict of a check. One that crashes, for example over a damaged file, does not hold, and says why."""
    try:
        holds, detail = check(evidence)
    except BaseException as error:
        return Finding(name, False, failure(error).reason)
    return Finding(name, holds, detail)
