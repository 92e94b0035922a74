"""What a value is made of: all arrays and tensors in it, however deep."""

from __future__ import annotations

from collections.abc import Iterator
from types import FunctionType, ModuleType
from typing import Any

_MOST = 200_000  # objects that are looked into: bounds the time
_PLAIN = (str, bytes, int, float, bool, type, ModuleType, FunctionType)


def arrays_in(value: Any, apart: tuple[type, ...] = ()) -> Iterator[Any]:
    """Each array and tensor that a value holds in containers or attributes, once; of a sparse tensor its parts.

    Objects of the types in `apart` are not looked into. Nothing is loaded to know an array.
    """
    seen: set[int] = set()
    left = [value]
    while left and len(seen) < _MOST:
        each = left.pop()
        if id(each) in seen or isinstance(each, (*_PLAIN, *apart)):
            continue
        seen.add(id(each))
        if getattr(each, "is_sparse", False):
            yield from (each._indices(), each._values())
        elif isinstance(getattr(each, "nbytes", None), int) and hasattr(each, "shape"):
            yield each
        elif isinstance(each, dict):
            left += each.values()
        elif isinstance(each, list | tuple | set | frozenset):
            left += each
        else:
            left += vars(each).values() if hasattr(each, "__dict__") else ()
            slots = (name for kind in type(each).__mro__ for name in getattr(kind, "__slots__", ()))
            left += [getattr(each, name) for name in slots if hasattr(each, name)]
