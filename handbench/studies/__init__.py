"""Studies: what is found out beside the protocols. Each is a function, and a verb of its name."""

from ..registry import Entry

_HERE = "handbench.studies"

ENTRIES = (
    Entry("audit", f"{_HERE}.audit:audit", "check a finished run: calibration, leaks, pixels, scores, NaN, keys"),
    Entry("stress", f"{_HERE}.stress.run:stress", "try hard cases on the core and every method"),
    Entry("speed", f"{_HERE}.speed.study:study", "error against time of the lighting core, rivals, every method"),
    Entry("geometry", f"{_HERE}.geometry.study:run", "train the hand geometry autoencoder and measure its errors"),
)

SUMMARIES = {entry.name: entry.summary for entry in ENTRIES}
