"""What can be wrong with a picture, or with what was fitted to it: a kind for programs and a sentence for people."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from ...errors import InputError

Kind: TypeAlias = Literal[
    "no key points",
    "empty mask",
    "two hands",
    "depth unit",
    "focal length",
    "distance",
    "pose",
    "other hand",
    "cut",
    "no hand",
    "missed",
]


@dataclass(frozen=True)
class Problem:
    """A problem of one picture. `fatal` ones make its fit useless; the others leave it less certain."""

    kind: Kind
    picture: str
    text: str
    fatal: bool = True

    def __str__(self) -> str:
        return f"{self.picture}: {self.text}"


class Unfittable(InputError):
    """No hand can be fitted to what was given; `problems` say why, and the error's text is the first of them."""

    def __init__(self, problems: tuple[Problem, ...]) -> None:
        self.problems = problems
        more = f" (and {len(problems) - 1} more pictures like it)" if len(problems) > 1 else ""
        super().__init__(f"{problems[0]}{more}")
