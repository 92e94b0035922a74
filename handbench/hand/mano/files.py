"""MANO's file: found, read once, checked, and kept as plain arrays."""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from ...cache import cache_folder
from ...errors import Absent, HandbenchError, InputError
from ...files import read_bytes, whole
from ...scene import Array
from ..handmodel import Side
from .unpickle import LIMIT, read_pickle

ENVIRONMENT = "HANDBENCH_MANO"
_NAMES: dict[Side, str] = {"right": "MANO_RIGHT.pkl", "left": "MANO_LEFT.pkl"}
_SHAPES = {
    "v_template": (778, 3),
    "shapedirs": (778, 3, 10),
    "posedirs": (778, 3, 135),
    "J_regressor": (16, 778),
    "weights": (778, 16),
    "kintree_table": (2, 16),
    "f": (1538, 3),
    "hands_components": (45, 45),
    "hands_mean": (45,),
}
_LAYOUT = 1  # of what is kept


@dataclass(frozen=True, eq=False)
class ManoFile:
    """MANO's arrays under its own names, float64; `digest` is that of the file they are from.

    v_template (778, 3) metres; shapedirs (778, 3, 10); posedirs (778, 3, 135); J_regressor (16, 778); weights
    (778, 16); parents (16,) with -1 for the root; faces (1538, 3); hands_components (45, 45), one component a row;
    hands_mean (45,).
    """

    v_template: Array
    shapedirs: Array
    posedirs: Array
    J_regressor: Array
    weights: Array
    parents: Array
    faces: Array
    hands_components: Array
    hands_mean: Array
    digest: str


def find_mano(side: Side) -> Path:
    """The file of a side that HANDBENCH_MANO names, by itself or by its folder. Raises `Absent` if there is none."""
    named = os.environ.get(ENVIRONMENT, "")
    place = Path(named)
    if named and place.is_dir():
        for candidate in (place / _NAMES[side], place / "models" / _NAMES[side]):
            if candidate.is_file():
                return candidate
    elif named and place.is_file():
        other = _NAMES["left" if side == "right" else "right"]
        if place.name.upper() != other.upper():
            return place
        if (beside := place.with_name(_NAMES[side])).is_file():
            return beside
    where = f"{ENVIRONMENT} is {named!r}, and there is none" if named else f"{ENVIRONMENT} names none"
    raise Absent(
        f"MANO's {side} hand needs {_NAMES[side]}, which its authors license and handbench does not bring: {where}; "
        f"get it from them and set {ENVIRONMENT} to the file or its folder"
    )


def read_mano(path: Path) -> ManoFile:
    """MANO's file, .pkl as its authors give it or .npz of the same arrays; a pickle is kept as .npz in the cache.

    Raises `InputError` for a file that is missing or is not MANO's: what a pickle may name, every shape, and what must
    hold of weights, regressor and skeleton are looked at.
    """
    if path.suffix.lower() == ".npz":
        from ...data.arrays import read_arrays

        return _checked(path, read_arrays(path, "MANO file", LIMIT), _digest(path))
    digest = _digest(path)
    kept = cache_folder() / "mano" / f"{digest[:32]}-{_LAYOUT}.npz"
    with suppress(HandbenchError, OSError):
        return _kept(kept, digest)
    found = _checked(path, read_pickle(path, "MANO file"), digest)
    with suppress(OSError):  # without it the pickle is read again
        kept.parent.mkdir(parents=True, exist_ok=True)
        with whole(kept) as part, part.open("wb") as file:
            np.savez(file, **{f.name: getattr(found, f.name) for f in fields(found) if f.name != "digest"})
    return found


def _digest(path: Path) -> str:
    return hashlib.sha256(read_bytes(path, LIMIT, "MANO file")).hexdigest()


def _kept(path: Path, digest: str) -> ManoFile:
    from ...data.arrays import read_arrays

    arrays = read_arrays(path, "MANO file", LIMIT)
    return ManoFile(**{f.name: arrays[f.name] for f in fields(ManoFile) if f.name != "digest"}, digest=digest)


def _checked(path: Path, told: Any, digest: str) -> ManoFile:
    def refuse(why: str) -> InputError:
        return InputError(f"MANO file {path} {why}; give MANO_RIGHT.pkl or MANO_LEFT.pkl of MANO 1.2")

    if not isinstance(told, dict):
        raise refuse(f"holds a {type(told).__name__}, no table")
    arrays: dict[str, Array] = {}
    for name, shape in _SHAPES.items():
        if name not in told:
            raise refuse(f"has no {name}")
        value = np.asarray(told[name])
        if value.dtype.kind not in "fiu" or value.shape != shape:
            raise refuse(f"has {name} of shape {value.shape}, expected {shape}")
        if not np.isfinite(value.astype(np.float64)).all():
            raise refuse(f"has NaN in {name}")
        arrays[name] = value.astype(np.float64)
    table = np.asarray(told["kintree_table"]).astype(np.int64)
    parents, faces = table[0].copy(), np.asarray(told["f"]).astype(np.int64)
    parents[0] = -1  # 2^32 - 1 in the file
    if not ((parents[1:] >= 0) & (parents[1:] < np.arange(1, 16))).all():
        raise refuse("has a skeleton in which a joint hangs on a later one")
    if faces.min() < 0 or faces.max() >= 778:
        raise refuse("has faces that point outside its vertices")
    weights, regressor = arrays["weights"], arrays["J_regressor"]
    if (weights < 0).any() or not np.allclose(weights.sum(1), 1, atol=1e-3):
        raise refuse("has skinning weights that do not sum to one")
    if not np.allclose(regressor.sum(1), 1, atol=1e-3):
        raise refuse("has a joint regressor that does not sum to one")
    across = float(np.ptp(arrays["v_template"], axis=0).max())
    if not 0.1 < across < 0.4:
        raise refuse(f"has a hand that is {across:.3g} m across")
    return ManoFile(
        arrays["v_template"],
        arrays["shapedirs"],
        arrays["posedirs"],
        regressor,
        weights / weights.sum(1, keepdims=True),
        parents,
        faces,
        arrays["hands_components"],
        arrays["hands_mean"],
        digest,
    )
