"""What values of a record must be beyond their type: names, counts, times, amounts."""

from __future__ import annotations

from typing import Annotated

from ..files import LONGEST_KEY
from .schema import Rule


def _names_a_file(text: str) -> bool:
    return 0 < len(text.encode()) <= 200 and text not in (".", "..") and not any(c in "/\\" or c < " " for c in text)


Name = Annotated[str, Rule("a name that a file can have", _names_a_file)]
Key = Annotated[str, Rule("a line", lambda text: text.isprintable() and 0 < len(text) <= LONGEST_KEY)]
Count = Annotated[int, Rule("0 or more", lambda value: value >= 0)]
Duration = Annotated[float, Rule("a time from 0 to 1e12", lambda value: 0.0 <= value <= 1e12)]
Amount = Annotated[float, Rule("from 0 to 1e15", lambda value: 0.0 <= value <= 1e15)]
Value = Annotated[float, Rule("from -1e100 to 1e100", lambda value: -1e100 <= value <= 1e100)]
Decimals = Annotated[int, Rule("from 0 to 12", lambda value: 0 <= value <= 12)]
