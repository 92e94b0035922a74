"""Options behind a name: `NAME[:option=NUMBER,flag,…]`, as lights and cameras are named."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError, shortened, unknown_name


def split_options(
    text: str, what: str, numbers: Sequence[str], flags: Sequence[str] = ()
) -> tuple[str, dict[str, float]]:
    """The name, and its options by name; a flag is 1. A name that is a file's, colon and all, has no options.

    Raises `InputError`, which calls it `what`, for an option that there is not, and a value that is no finite number.
    """
    name, colon, rest = text.rpartition(":")
    if not colon or Path(text).exists() or not all(each in flags or "=" in each for each in rest.split(",")):
        return text, {}
    if "/" in rest or "\\" in rest:  # the rest of a path
        return text, {}
    found: dict[str, float] = {}
    for option in rest.split(","):
        key, equals, value = option.partition("=")
        if key not in (*numbers, *flags):
            raise unknown_name(f"option of a {what}", key, (*numbers, *flags))
        if key in flags and equals:
            raise InputError(f"{what} {shortened(text)}: {key} takes no value; leave it out")
        found[key] = 1.0 if key in flags else _number(text, what, key, value)
    return name, found


def _number(text: str, what: str, key: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise InputError(f"{what} {shortened(text)}: {key} is {shortened(value)}; give a number")
    return number
