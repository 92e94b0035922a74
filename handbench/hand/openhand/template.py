"""The hand template as data: what `template.npz` holds, read once.

The file is cut from the CC0 MakeHuman base mesh by `maintainer/make_hand_template.py`; `source` says from what.
"""

from __future__ import annotations

import functools
import importlib.resources
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FINGERS = ("thumb", "index", "middle", "ring", "little")


@dataclass(frozen=True, eq=False)
class Template:
    """The neutral right hand in canonical space (metres, wrist at the origin, +y to the middle tip, palm to +z).

    vertices (V, 3); quads (Q, 4); uvs (T, 2); uv_quads (Q, 4), corners in the order of `quads`; weights (V, J);
    points (J + 5, 3): joints, then the finger tips; shapes (B, V, 3) and point_shapes (B, J + 5, 3): displacement
    per unit of blend coefficient; dorsal (5, 3): where the nails face; nail (V,) in [0, 1]. Arrays are float64.
    """

    vertices: NDArray[Any]
    quads: NDArray[Any]
    uvs: NDArray[Any]
    uv_quads: NDArray[Any]
    weights: NDArray[Any]
    points: NDArray[Any]
    shapes: NDArray[Any]
    point_shapes: NDArray[Any]
    dorsal: NDArray[Any]
    nail: NDArray[Any]
    shape_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    source: str


@functools.cache
def joint_names() -> tuple[str, ...]:
    """The joints, in the order of poses."""
    return load_template().joint_names


def load_template() -> Template:
    """The template in the package, read anew; its arrays are read-only."""
    with importlib.resources.files(__package__).joinpath("template.npz").open("rb") as file:
        data = dict(np.load(file))
    real = {
        name: data[name].astype(np.float64)
        for name in ("vertices", "uvs", "points", "shapes", "point_shapes", "dorsal", "nail")
    }
    weights = np.zeros((len(data["vertices"]), len(data["joint_names"])))
    weights[data["weight_vertices"], data["weight_joints"]] = data["weight_values"]
    real["weights"] = weights / weights.sum(1, keepdims=True)  # float32 on disk: make the sums exact again
    real["quads"], real["uv_quads"] = data["quads"].astype(np.int64), data["uv_quads"].astype(np.int64)
    for array in real.values():
        array.flags.writeable = False
    return Template(
        **real,
        shape_names=tuple(map(str, data["shape_names"])),
        joint_names=tuple(map(str, data["joint_names"])),
        parents=tuple(map(int, data["parents"])),
        source=str(data["source"]),
    )
