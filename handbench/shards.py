"""Shards: a plan of work in numbered parts, for arrays of jobs that share a folder."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from .errors import InputError

_Piece = TypeVar("_Piece")


@dataclass(frozen=True)
class Shard:
    """Part `number` (from 1) of the `count` parts of a plan."""

    number: int
    count: int

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.count:
            raise InputError(f"shard {self} does not exist; give i/n with i from 1 to n, such as 1/4 … 4/4")

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    @staticmethod
    def parse(text: str) -> Shard:
        """The shard that "i/n" names; raises `InputError` for anything else."""
        found = re.fullmatch(r"\s*(\d{1,9})\s*/\s*(\d{1,9})\s*", text, re.ASCII)
        if found is None:
            raise InputError(f"shard {text!r} cannot be read; give i/n, such as 1/4 for the first of four")
        return Shard(int(found[1]), int(found[2]))

    def of(self, groups: Sequence[Sequence[_Piece]]) -> tuple[_Piece, ...]:
        """The pieces of this shard. All shards together have every piece once.

        Pieces of a group share a piece of work and stay together, unless there are more shards than groups: then
        several shards have pieces of one group, which one of them does.
        """
        mine: list[_Piece] = []
        for index, group in enumerate(groups):
            owners = range(index % self.count, self.count, len(groups))
            mine += [piece for i, piece in enumerate(group) if owners[i % len(owners)] == self.number - 1]
        return tuple(mine)
