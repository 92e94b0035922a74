"""Files of hand poses: .npz in handbench's own terms or in MANO's, checked where they come in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..errors import InputError
from ..files import whole
from ..hand.handmodel import HandModel
from ..scene import Array, Pose
from .arrays import read_arrays

_OWN = {"joints", "rotation", "translation", "shape"}
_MANO = {"hand_pose", "global_orient", "transl", "betas"}
_LIMIT = 256 << 20  # bytes
_REACH = 20.0  # metres from the origin: no hand that a camera sees is farther
_TURNS = 4 * np.pi  # of an axis-angle: whoever has more has degrees


@dataclass(frozen=True, eq=False)
class PoseAndShape:
    """A pose, and the shape (S,) of who takes it, None where the file does not tell."""

    pose: Pose
    shape: Array | None


def read_poses(
    path: Path, hand: HandModel, flat_hand_mean: bool | None = None, unit: float = 1.0
) -> tuple[PoseAndShape, ...]:
    """The poses in a .npz file: one, or N of them where every array has a leading N.

    In handbench's terms: joints (J, 3), rotation (3,), translation (3,), shape (S,) of the hand model. In MANO's:
    hand_pose (45,), (15, 3) or fewer PCA coefficients, global_orient (3,), transl (3,), betas (10,); then
    `flat_hand_mean` must say whether poses are whole (True) or relative to the mean pose (False). Everything but joints
    or hand_pose may be left out; a shape may be there once for all. `unit` is how many metres the file's unit is.
    Raises `InputError` for a file that is none of these, and for values that are no pose.
    """
    arrays = read_arrays(path, "pose file", _LIMIT)
    names, owner = set(arrays), f"pose file {path}"
    if "joints" in names and not names - _OWN:
        return _own(owner, arrays, hand, unit)
    if "hand_pose" in names and not names - _MANO:
        return _mano(owner, arrays, hand, flat_hand_mean, unit)
    raise InputError(
        f"{owner} holds {', '.join(sorted(names)) or 'nothing'}; expected joints with any of rotation, translation, "
        "shape, or MANO's hand_pose with any of global_orient, transl, betas"
    )


def _own(owner: str, arrays: Mapping[str, Array], hand: HandModel, unit: float) -> tuple[PoseAndShape, ...]:
    sizes: dict[str, tuple[tuple[int, ...], ...]] = {
        "joints": ((len(hand.joint_names), 3),),
        "rotation": ((3,),),
        "translation": ((3,),),
        "shape": ((hand.shape_size,),),
    }
    rows = _rows(owner, arrays, sizes, "joints", f"of the hand model {hand.name!r}")
    return tuple(
        PoseAndShape(
            _sane(owner, Pose(row["joints"], row.get("rotation", _ZERO), unit * row.get("translation", _ZERO))),
            row.get("shape"),
        )
        for row in rows
    )


def _mano(
    owner: str, arrays: Mapping[str, Array], hand: HandModel, flat_hand_mean: bool | None, unit: float
) -> tuple[PoseAndShape, ...]:
    from ..hand.mano import ManoHand

    if not isinstance(hand, ManoHand):
        raise InputError(f"{owner} holds MANO's hand_pose, but the hand model is {hand.name!r}; say hand = mano-right")
    if flat_hand_mean is None:
        raise InputError(
            f"{owner} holds MANO's hand_pose: say flat_hand_mean = true if it is whole, or false if it is relative to "
            "the mean pose (the default of the smplx package); the wrong one bends fingers by 20 to 40 degrees"
        )
    found = np.asarray(arrays["hand_pose"])
    width = found.shape[-1] if found.ndim else 0
    pca = ((width,),) if width != 3 and 0 < width <= 45 else ()
    sizes = {"hand_pose": ((15, 3), *pca), "global_orient": ((3,),), "transl": ((3,),), "betas": ((10,),)}
    posed = []
    for row in _rows(owner, arrays, sizes, "hand_pose", "of MANO"):
        betas = row.get("betas")
        pose = hand.pose_of(
            row["hand_pose"],
            row.get("global_orient", _ZERO),
            unit * row.get("transl", _ZERO),
            np.zeros(10) if betas is None else betas,
            flat_hand_mean=flat_hand_mean,
        )
        posed.append(PoseAndShape(_sane(owner, pose), betas))
    return tuple(posed)


_ZERO = np.zeros(3)


def _rows(
    owner: str,
    arrays: Mapping[str, Array],
    sizes: Mapping[str, tuple[tuple[int, ...], ...]],
    leading: str,
    whose: str,
) -> list[dict[str, Array]]:
    """The arrays of each pose; those without a leading N are of all."""
    counts, values = set(), {}
    for name, value in arrays.items():
        if value.dtype.kind not in "fiu" or not np.isfinite(value).all():
            raise InputError(f"{owner}: {name} holds {value.dtype} or NaN; give finite numbers")
        if value.shape in sizes[name]:
            values[name] = (False, value.astype(np.float64))
        elif value.shape[1:] in sizes[name]:
            values[name] = (True, value.astype(np.float64))
            counts.add(len(value))
        else:
            wanted = " or ".join(map(str, sizes[name]))
            raise InputError(f"{owner}: {name} has shape {value.shape}, expected {wanted} {whose}, or N of them")
    if len(counts) > 1 or 0 in counts or (counts and not values[leading][0]):
        raise InputError(f"{owner}: its arrays are of {sorted(counts)} poses; give every array the same number")
    return [
        {name: value[i] if many else value for name, (many, value) in values.items()} for i in range(max(counts or {1}))
    ]


def _sane(owner: str, pose: Pose) -> Pose:
    if max(np.abs(pose.joints).max(initial=0.0), np.abs(pose.rotation).max()) > _TURNS:
        raise InputError(f"{owner}: axis-angles reach beyond {_TURNS:.0f}; give radians, not degrees")
    away = float(np.linalg.norm(pose.translation))
    if away > _REACH:
        raise InputError(f'{owner}: the hand is {away:.3g} m away; if these are millimetres, say units = "millimetres"')
    return pose


def turned(pose: Pose, world: Array) -> Pose:
    """A pose after the world is turned by a rotation (3, 3)."""
    rotation = (Rotation.from_matrix(world) * Rotation.from_rotvec(pose.rotation.copy())).as_rotvec()
    return Pose(pose.joints, rotation, world @ pose.translation)


def write_poses(
    path: Path, poses: Sequence[tuple[Pose, Array]], hand: HandModel, flat_hand_mean: bool | None = None
) -> None:
    """Write poses and shapes as `read_poses` reads them, each array with a leading N: MANO's in MANO's terms.

    Raises `InputError` for MANO's hand without `flat_hand_mean`, `StorageError` if it cannot be written.
    """
    from ..hand.mano import ManoHand

    if isinstance(hand, ManoHand):
        if flat_hand_mean is None:
            raise InputError(
                "poses of MANO are written whole or relative to the mean pose: say which (--flat-hand-mean)"
            )
        rows = [hand.parameters_of(pose, shape, flat_hand_mean=flat_hand_mean) for pose, shape in poses]
    else:
        rows = [
            {"joints": p.joints, "rotation": p.rotation, "translation": p.translation, "shape": np.asarray(s)}
            for p, s in poses
        ]
    with whole(path, "choose another place with --out") as part, part.open("wb") as file:
        arrays: dict[str, Any] = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
        np.savez(file, **arrays)
