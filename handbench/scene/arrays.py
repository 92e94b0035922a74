"""Arrays of the scene: checked where they come in, read-only from then on."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError

Array: TypeAlias = NDArray[Any]


def checked(owner: str, name: str, value: ArrayLike, shape: tuple[int | None, ...], dtype: type) -> Array:
    """A read-only array of the given shape (None: any size), or an `InputError` that names what is wrong."""
    array: Array = np.asarray(value, dtype=dtype)
    fits = array.ndim == len(shape) and all(s is None or s == n for s, n in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = "(" + ", ".join("n" if s is None else str(s) for s in shape) + ")"
        raise InputError(f"{owner}: {name} has shape {array.shape}, expected {wanted}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        bad = int(np.count_nonzero(~np.isfinite(array)))
        raise InputError(f"{owner}: {name} holds {bad} values that are NaN or infinite; remove them first")
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array


def measured(owner: str, name: str, value: ArrayLike) -> Array:
    """What a camera or a method gives, as an array. Raises `InputError` for whole numbers: those are codes."""
    array: Array = np.asarray(value)
    if array.dtype.kind in "iu" or (array.dtype.kind == "b" and name != "alpha"):
        remedy = "divide by the greatest code" + ("" if name == "alpha" else ", then make sRGB linear")
        raise InputError(f"{owner}: {name} holds whole numbers ({array.dtype}), expected floats; {remedy}")
    return array


def put(instance: object, name: str, value: object) -> None:
    """Set a field of a frozen dataclass while it is made."""
    object.__setattr__(instance, name, value)
