"""A part of a protocol: some of its subjects, a few frames of each column. Training stays as it is, and is shared."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from ..errors import InputError, unknown_name
from .protocol import Column, Protocol

_TOLD = re.compile(r": (?:only ([^:]+?))?(?:, )?(?:at most (\d{1,9}) frames? a column)?$")


def narrowed(protocol: Protocol, subjects: Sequence[str] | None = None, limit: int | None = None) -> Protocol:
    """The protocol with the columns of some subjects only, each with at most `limit` frames.

    Its title tells so, and its digest differs: narrowed results never share a table with whole ones. What is trained
    on does not change. Raises `InputError` for a subject that no column scores.
    """
    if subjects is None and limit is None:
        return protocol
    if limit is not None and limit < 1:
        raise InputError(f"limit is {limit}; give at least 1 frame a column")
    for subject in subjects or ():
        if subject not in protocol.subjects:
            raise unknown_name(f"subject of protocol {protocol.label}:", subject, protocol.subjects)
    kept = set(subjects or protocol.subjects)
    columns = tuple(column for each in protocol.columns if (column := _column(protocol, each, kept, limit)))
    names = {column.name for column in columns}
    published = tuple(
        replace(row, values=tuple(value for value in row.values if value[0] in names)) for row in protocol.published
    )
    title = f"{protocol.title}: {what_is_left(subjects, limit)}"
    part = "-".join([*(subjects or ()), *([f"limit-{limit}"] if limit else [])])
    return replace(protocol, title=title, columns=columns, published=published, part=part)


def narrowed_as(protocol: Protocol, title: str) -> Protocol:
    """The protocol narrowed as the title of such a one tells; whole if it tells nothing that fits."""
    if not (found := _TOLD.search(title)):
        return protocol
    subjects = found[1].split(", ") if found[1] else None
    if not set(subjects or ()) <= set(protocol.subjects):
        return protocol
    return narrowed(protocol, subjects, int(found[2]) if found[2] else None)


def what_is_left(subjects: Sequence[str] | None, limit: int | None) -> str:
    """What is left, in words."""
    words = [f"only {', '.join(subjects)}"] if subjects else []
    words += [f"at most {limit} frame{'s' * (limit > 1)} a column"] if limit else []
    return ", ".join(words)


def _column(protocol: Protocol, column: Column, kept: set[str], limit: int | None) -> Column | None:
    """A column of the subjects that are kept; None if it has none of them."""
    subjects = tuple(subject for subject in protocol.subjects_of(column) if subject in kept)
    most = min((each for each in (column.limit, limit) if each is not None), default=None)
    named = column.subjects if subjects == protocol.subjects_of(column) else subjects
    return replace(column, subjects=named, limit=most) if subjects else None
