"""What is worked out once and shared by all who ask: whoever writes into it is found out, and it is put back.

numpy's read-only flag holds nobody back (`torch.from_numpy` writes through it), and copies for every borrower, as
frames have them, would make each subdivide the surface anew. So each value has a checksum of its arrays.
"""

from __future__ import annotations

import warnings
import zlib
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import numpy as np
import torch
from torch import Tensor

from ..contents import arrays_in

T = TypeVar("T")


@dataclass
class _Made:
    value: Any
    make: Callable[[], Any]
    arrays: tuple[Any, ...]
    checksum: int


class Watched:
    """Values by key, in the order in which they were made. Objects of the types in `apart` that they hold are not
    theirs. Copies and pickles of it are empty."""

    def __init__(self, *apart: type) -> None:
        self._apart = apart
        self._made: dict[Hashable, _Made] = {}

    def __reduce__(self) -> tuple[type[Watched], tuple[type, ...]]:
        return Watched, self._apart

    def __call__(self, key: Hashable, make: Callable[[], T]) -> T:
        """The value of a key, made when it is first asked for; `make` must give equal arrays whenever it is called."""
        if key not in self._made:
            value = make()
            # those it has now: what it works out later is its own affair
            arrays = tuple(self._arrays(value))
            self._made[key] = _Made(value, make, arrays, _checksum(arrays))
        return cast(T, self._made[key].value)

    def items(self) -> list[tuple[Any, Any]]:
        """Key and value of all that were made so far."""
        return [(key, made.value) for key, made in self._made.items()]

    def drop(self, key: Hashable) -> None:
        """Make a value anew when it is asked for again; who has the old one keeps it."""
        self._made.pop(key, None)

    def changed(self) -> list[Hashable]:
        """The keys of values that somebody wrote into."""
        return [key for key, made in self._made.items() if _checksum(made.arrays) != made.checksum]

    def restore(self, keys: Iterable[Hashable] | None = None) -> None:
        """Make values again, all by default, into the memory where they are: whoever has them has the right ones."""
        for key in self._made if keys is None else keys:
            made = self._made[key]
            fresh = tuple(self._arrays(made.make()))
            with torch.inference_mode():  # in which a tensor may have been made, which cannot be changed outside
                for array, right in zip(made.arrays, fresh, strict=True):
                    _tensor(array).copy_(_tensor(right))
            made.checksum = _checksum(made.arrays)

    def _arrays(self, value: Any) -> Iterator[Any]:
        within = vars(value) if isinstance(value, self._apart) else value  # a value of such a type is meant itself
        for each in arrays_in(within, (*self._apart, Watched)):
            if isinstance(each, Tensor) or (isinstance(each, np.ndarray) and each.dtype.kind in "biuf"):
                yield each


def _tensor(array: Any) -> Tensor:
    """A tensor that shares the array's memory, read-only or not."""
    if isinstance(array, Tensor):
        return array
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return torch.from_numpy(array)


def _checksum(arrays: tuple[Any, ...]) -> int:
    found = 0
    for array in arrays:
        if isinstance(array, Tensor):
            if array.is_meta:  # it holds no values
                continue
            array = array.detach().cpu().reshape(-1).view(torch.uint8).numpy()
        found = zlib.crc32(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data, found)
    return found
