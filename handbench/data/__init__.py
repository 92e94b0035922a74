"""Captures: the open light stage and readers of recorded ones; `ENTRIES` is the table the harness reads."""

from ..registry import Entry

ENTRIES: tuple[Entry, ...] = (
    Entry("openstage", "handbench.data.openstage:open_capture", "the open light stage: path traced from a CC0 hand"),
)
