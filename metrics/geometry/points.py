"""Points that correspond one to one: joints, and vertices of meshes of one topology. Mean distance, in mm.

The joint error is what pose papers call MPJPE, without alignment.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from handbench.errors import InputError, Unsupported
from handbench.scene import Array

from ..base import PairFamily
from ..pair import Pair
from .units import same_unit

_MM = 1000.0


def point_error(found: Array, true: Array) -> float:
    """Mean distance in mm of corresponding points (N, 3). Raises `InputError` for unequal shapes or no points."""
    if found.shape != true.shape or not len(true):
        raise InputError(f"point_error: {found.shape} and {true.shape} do not correspond; give equal shapes")
    return float(_MM * np.linalg.norm(found - true, axis=-1).mean())


def _joints(pair: Pair, options: Mapping[str, str]) -> float:
    found, true = np.asarray(pair.prediction_joints), np.asarray(pair.truth_joints)
    if len(found) != len(true):
        raise Unsupported(f"other joints: the prediction has {len(found)}, the truth {len(true)}")
    same_unit("the joints span", _extent(found), _extent(true))
    return point_error(found, true)


def _vertices(pair: Pair, options: Mapping[str, str]) -> float:
    found, true = pair.prediction_mesh, pair.truth_mesh
    if found is None or true is None:
        raise Unsupported("no meshes to compare")
    sizes = (len(found.vertices), len(true.vertices))
    if sizes[0] != sizes[1] or not np.array_equal(found.topology.faces, true.topology.faces):
        raise Unsupported(f"another topology: {sizes[0]} vertices do not correspond to the truth's {sizes[1]}")
    same_unit("the mesh spans", _extent(found.vertices), _extent(true.vertices))
    return point_error(found.vertices, true.vertices)


def _extent(points: Array) -> float:
    return float(np.ptp(points, axis=0).max()) if len(points) else 0.0


JOINT = PairFamily(
    name="joint",
    title="Joints",
    measure=_joints,
    higher_is_better=False,
    unit="mm",
    decimals=2,
    terms=("align:none",),
    perfect=0.0,
    needs=("prediction_joints", "truth_joints"),
)
VERTEX = PairFamily(
    name="vertex",
    title="Vertices",
    measure=_vertices,
    higher_is_better=False,
    unit="mm",
    decimals=2,
    terms=("align:none", "topology:same"),
    perfect=0.0,
    needs=("prediction_mesh", "truth_mesh"),
)
