"""Who the hand belongs to: blend shapes and the proportions of single bones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError


@dataclass(frozen=True, eq=False)
class Identity:
    """blend (B,) coefficients; bone_length, bone_width (J,) factors along and across each joint's bone (1: neutral).

    `numpy.asarray` of it is the shape (B + 2 J,) that a `HandModel` takes.
    """

    blend: NDArray[Any]
    bone_length: NDArray[Any]
    bone_width: NDArray[Any]

    def __post_init__(self) -> None:
        for name in ("blend", "bone_length", "bone_width"):
            value = np.array(getattr(self, name), dtype=np.float64)
            if value.ndim != 1:
                raise InputError(f"identity: {name} has shape {value.shape}, expected a vector")
            if not np.isfinite(value).all():
                raise InputError(f"identity: {name} holds NaN or infinity; give finite values")
            if name != "blend" and (value <= 0).any():
                raise InputError(f"identity: {name} has {value.min():g}, but factors must be positive (1 is neutral)")
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.concatenate([self.blend, self.bone_length, self.bone_width]).astype(dtype or np.float64)

    def scaled(self, factor: float) -> Identity:
        """The same hand, larger or smaller."""
        return Identity(self.blend, self.bone_length * factor, self.bone_width * factor)
