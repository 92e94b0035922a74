"""A method is handed copies of its own, which are compared with the originals when it is done.

numpy's read-only flag holds nobody back: `torch.from_numpy` writes through it. So no method gets an array that another
one sees, and one that changes what it was given fails by name, since its own answers are no longer to the question.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar, get_args

import numpy as np

from ..errors import Changed
from ..scene import Array, Frame, Light, Prediction
from .resolving import Selected

T = TypeVar("T")


@dataclass(frozen=True, eq=False, slots=True)
class _Lent:
    """A copy that was handed over, and what tells whether it is still what it was.

    original    the array that it is a copy of; the digest of one that is not kept; or what a dataclass holds
    owner       what it belongs to
    where       the first frame that has it
    """

    original: Array | str | tuple[Any, ...]
    copy: Any
    owner: str
    where: str

    @property
    def changed(self) -> bool:
        if isinstance(self.original, tuple):
            now = tuple(vars(self.copy).values())  # what was worked out of it since, or read late, comes last
            return len(now) < len(self.original) or any(a is not b for a, b in zip(now, self.original, strict=False))
        if isinstance(self.original, str):
            return _digest(self.copy) != self.original
        return not np.array_equal(self.original, self.copy)


class Lender:
    """Lends the frames of a run, to one method after the other.

    All cells of a method get the same copies, in which frames share meshes, lights and topologies as the originals do:
    what a method works out of a mesh or a topology, it works out once.
    """

    def __init__(self) -> None:
        self._for: tuple[Selected, str] | None = None
        self._copies: Selected
        self._lent: list[_Lent] = []

    def lend(self, selected: Selected, borrower: str) -> Selected:
        """The frames as copies that the borrower alone has."""
        if self._for is None or self._for[0] is not selected or self._for[1] != borrower:
            _forget_atlases()
            copier = _Copier()
            train, enrol = copier.frames(selected.train), copier.frames(selected.enrol)
            scored = {column: copier.frames(frames) for column, frames in selected.scored.items()}
            self._copies = replace(selected, train=train, enrol=enrol, scored=scored)
            self._lent, self._for = copier.lent, (selected, borrower)
        return self._copies

    def check(self) -> None:
        """Raise `Changed` if the borrower changed anything; the next cell then gets new copies.

        Hand models are shared, as what is worked out of one serves all who use it; they are put back."""
        hands = _restored_hands()
        if hands:
            self._for = None
            raise Changed(f"the hand model {hands[0]}")
        for lent in self._lent:
            if lent.changed:
                self._for = None
                raise Changed(f"the {lent.owner} of {lent.where}")


def copied(value: T) -> T:
    """A value of the scene with arrays of its own."""
    made: T = _Copier().of(value, "")
    return made


def answered(prediction: Prediction) -> Prediction:
    """An answer that stays what it is when the method draws the next one into the same arrays."""
    arrays: dict[str, Any] = {
        f.name: v.copy() for f in fields(prediction) if isinstance(v := getattr(prediction, f.name), np.ndarray)
    }
    return replace(prediction, **arrays)


def _forget_atlases() -> None:
    """They may be of what was changed, and the last borrower had them in hand. Nothing is loaded to have none."""
    atlas = sys.modules.get("handbench.render.uv.atlas")
    if atlas is not None:
        atlas.forget()


def _restored_hands() -> list[str]:
    """The hand models that were changed, which they are no more. Nothing is loaded to have none."""
    known = sys.modules.get("handbench.hand.known")
    return known.restored() if known is not None else []


def _digest(array: Array) -> str:
    return hashlib.blake2b(np.ascontiguousarray(array).data, digest_size=16).hexdigest()


def _named(kind: type) -> str:
    return "light" if kind in get_args(Light) else kind.__name__.lower()


class _Copier:
    """Copies dataclasses and tuples of them; what they share is copied once."""

    def __init__(self) -> None:
        self.lent: list[_Lent] = []
        self._made: dict[int, tuple[Any, Any]] = {}  # by identity, beside the original, which must live as long

    def frames(self, frames: tuple[Frame, ...]) -> tuple[Frame, ...]:
        return tuple(self.of(frame, frame.key) for frame in frames)

    def of(self, value: Any, where: str, owner: str = "") -> Any:
        """The copy of a value that was found in the frame `where`, in a dataclass called `owner`."""
        if not isinstance(value, (np.ndarray, tuple)) and not is_dataclass(value):
            return value
        if id(value) not in self._made:
            self._made[id(value)] = value, self._copy(value, where, owner)
        return self._made[id(value)][1]

    def _copy(self, value: Any, where: str, owner: str) -> Any:
        if isinstance(value, tuple):
            return tuple(self.of(item, where, owner) for item in value)
        if isinstance(value, np.ndarray):
            made = value.copy()
            made.flags.writeable = False
            self.lent.append(_Lent(value, made, owner, where))
            return made
        twin, named = object.__new__(type(value)), _named(type(value))  # what was validated once is not validated again
        for name, item in vars(value).items():
            # of `Pose.unread` and `Mesh.unread`
            own = self._later(item, where, named) if name == "_read" else self.of(item, where, named)
            object.__setattr__(twin, name, own)
        self.lent.append(_Lent(tuple(vars(twin).values()), twin, named, where))
        return twin

    def _later(self, read: Callable[[], Any], where: str, owner: str) -> Callable[[], Any]:
        """What reads an array, or a dataclass of arrays, for a copy: into arrays of its own, whose digests are kept."""

        def own(array: Array) -> Array:
            made = np.array(array, np.float64)
            made.flags.writeable = False
            self.lent.append(_Lent(_digest(made), made, owner, where))
            return made

        def reading() -> Any:
            found = read()
            if not is_dataclass(found):
                return own(found)
            twin = object.__new__(type(found))
            for name, array in vars(found).items():
                object.__setattr__(twin, name, own(array))
            return twin

        return reading
