"""MANO as a hand model: Romero, Tzionas, Black, "Embodied Hands" (2017), Eq. 1 to 5."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from torch import Tensor

from ...errors import Absent, InputError, unknown_name
from ...scene import Array, Pose, Topology
from ..handmodel import HandModel, Side, vector
from .files import ManoFile, find_mano, read_mano
from .unwrapped import read_layout, unwrapped

FINGERS = ("thumb", "index", "middle", "ring", "little")
JOINTS = ("wrist", *(f"{finger}{k}" for finger in ("index", "middle", "little", "ring", "thumb") for k in (1, 2, 3)))

TIPS = (744, 320, 443, 554, 671)
"""The vertices that are the tips of thumb, index, middle, ring and little finger, as smplx takes them."""

_SPREAD = 2.0  # standard deviations at which a random shape is cut off
_MIRROR = np.array([-1.0, 1.0, 1.0])


class ManoHand(HandModel):
    """MANO's right or left hand, in metres, with the wrist at the origin of canonical space.

    In its own axes a right hand at rest points its fingers to -x, its thumb to +z and its back to +y. A `Pose` holds
    whole rotations, the mean pose included: rest is the flat hand. `pose_of` and `parameters_of` change from and to
    MANO's own numbers. The left hand's shapes have the wrong sign in x in the file as it is given out; that is mended.
    """

    fingers = FINGERS
    levels = 0
    wrist = 0
    joint_names = JOINTS
    shape_size = 10

    def __init__(
        self,
        file: ManoFile,
        side: Side,
        layout: Path | None = None,
        right: ManoFile | None = None,
    ) -> None:
        """`layout` is an .obj of MANO's UVs; `right` the right hand's file, by which a left one's shapes are judged."""
        self.name, self.side, self.file = f"mano-{side}", side, file
        self.parents = tuple(file.parents.tolist())
        self.chains = tuple((JOINTS.index(f"{f}1"), JOINTS.index(f"{f}2"), JOINTS.index(f"{f}3")) for f in FINGERS)
        last = {chain[-1]: 16 + f for f, chain in enumerate(self.chains)}
        self.ends = np.array([JOINTS.index("middle1"), *(last.get(j, j + 1) for j in range(1, 16))])
        self.frames = np.tile(np.eye(3), (16, 1, 1))
        self.pose_shapes = file.posedirs
        self.tip_vertices = TIPS
        self._shapes, self._layout = _mended(file, side, right), layout
        self.points = self.rest_points(self.neutral(), torch.float64)[1].numpy()

    # -- MANO's own numbers ------------------------------------------------------------------------------------------

    def wrist_at(self, betas: ArrayLike) -> Array:
        """J_0 (3,): where the wrist of a shape (10,) is in MANO's own space, about which the hand turns."""
        shaped = self.file.v_template + self._shapes @ np.asarray(betas, np.float64)
        found: Array = self.file.J_regressor[0] @ shaped
        return found

    def pose_of(
        self,
        hand_pose: ArrayLike,
        global_orient: ArrayLike,
        transl: ArrayLike,
        betas: ArrayLike,
        *,
        flat_hand_mean: bool,
    ) -> Pose:
        """MANO's parameters as a pose: hand_pose (45,) or (15, 3) axis-angles, or K < 45 PCA coefficients.

        `flat_hand_mean` has the meaning it has in smplx: True if hand_pose is whole, False if the mean pose is to be
        added. There is no default, since packages differ and nothing fails for the wrong one. Metres; the wrist comes
        to J_0 + transl. Raises `InputError` for wrong shapes and for NaN.
        """
        given = np.asarray(hand_pose, np.float64).ravel()
        if len(given) < 45:
            given = given @ self.file.hands_components[: len(given)]
        whole = vector("hand_pose", given, (45,), torch.float64).numpy()
        if not flat_hand_mean:
            whole = whole + self.file.hands_mean
        shape = vector("betas", betas, (10,), torch.float64).numpy()
        placed: Array = self.wrist_at(shape) + np.asarray(transl, np.float64)
        turn = np.asarray(global_orient, np.float64)
        return Pose(np.concatenate([np.zeros((1, 3)), whole.reshape(15, 3)]), turn, placed)

    def parameters_of(self, pose: Pose, betas: ArrayLike, *, flat_hand_mean: bool) -> dict[str, Array]:
        """What `pose_of` makes the pose of: hand_pose (45,), global_orient (3,), transl (3,), betas (10,)."""
        if pose.joints.shape != (16, 3):
            raise InputError(f"a pose of MANO has 16 joints, this one has {len(pose.joints)}")
        turn = Rotation.from_rotvec(pose.rotation.copy()) * Rotation.from_rotvec(pose.joints[0].copy())
        whole = pose.joints[1:].ravel()
        return {
            "hand_pose": whole if flat_hand_mean else whole - self.file.hands_mean,
            "global_orient": turn.as_rotvec(),
            "transl": pose.translation - self.wrist_at(betas),
            "betas": np.asarray(betas, np.float64),
        }

    # -- the hand model ----------------------------------------------------------------------------------------------

    def neutral(self) -> Array:
        return np.zeros(10)

    def sample_identity(self, rng: np.random.Generator) -> Array:
        return np.clip(rng.standard_normal(10), -_SPREAD, _SPREAD)

    def sample_pose(self, rng: np.random.Generator, amount: float = 1.0) -> Pose:
        """Between flat and the mean pose, and the first components of MANO's space of poses."""
        if not 0 <= amount <= 1:
            raise InputError(f"sample_pose: amount {amount} is not in 0…1")
        coefficients = np.clip(rng.standard_normal(6), -_SPREAD, _SPREAD) * 0.6
        angles = rng.uniform(0, 1) * self.file.hands_mean + coefficients @ self.file.hands_components[:6]
        return Pose(amount * np.concatenate([np.zeros((1, 3)), angles.reshape(15, 3)]))

    def named_pose(self, name: str) -> Pose:
        if name == "rest":
            return Pose(np.zeros((16, 3)))
        if name == "mean":
            return Pose(np.concatenate([np.zeros((1, 3)), self.file.hands_mean.reshape(15, 3)]))
        raise unknown_name("pose", name, ["rest", "mean"])

    def rest_points(self, shape: Tensor | ArrayLike, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
        betas = vector("shape", shape, (10,), dtype)
        template, shapes, regressor = (
            torch.tensor(array, dtype=dtype) for array in (self.file.v_template, self._shapes, self.file.J_regressor)
        )
        vertices = template + shapes @ betas
        joints = regressor @ vertices
        vertices, joints = vertices - joints[0], joints - joints[0]
        return vertices, torch.cat([joints, vertices[list(self.tip_vertices or ())]])

    def rest_position(self, level: int) -> Array:
        self._level(level)
        return self.rest_points(self.neutral(), torch.float64)[0].numpy()

    def weights(self, level: int) -> Array:
        self._level(level)
        return self.file.weights

    def topology(self, level: int) -> Topology:
        self._level(level)
        return self.kept("topology", lambda: unwrapped(self.file.faces, self._layout))

    def edges(self) -> Array:
        return np.concatenate([self.file.faces[:, [i, (i + 1) % 3]] for i in range(3)])

    def subdivide(self, vertices: Tensor, level: int) -> Tensor:
        self._level(level)
        if vertices.ndim != 2 or len(vertices) != 778:
            raise InputError(f"subdivide: vertices have shape {tuple(vertices.shape)}, expected (778, n)")
        return vertices

    def _level(self, level: int) -> None:
        if level != 0:
            raise InputError(f"subdivision level {level} is not in 0…0: MANO has one surface")


def _mended(file: ManoFile, side: Side, right: ManoFile | None) -> Array:
    """The shape space (778, 3, 10). In MANO_LEFT.pkl as it is given out, x has the sign of the right hand's.

    Beside the right hand's file that shows at once: the x of both are equal. Without it the left hand tells itself: its
    first shape is size, so vertices move away from their middle, along x as along y and z.
    """
    if side == "right":
        return file.shapedirs
    if right is not None:
        wrong = float(np.abs(file.shapedirs[:, 0] - right.shapedirs[:, 0]).sum()) < 1.0
    else:
        away = file.v_template - file.v_template.mean(axis=0)
        along, *across = (away * file.shapedirs[:, :, 0]).sum(axis=0)
        wrong = along * sum(across) < 0
    return file.shapedirs * _MIRROR[:, None] if wrong else file.shapedirs


def create(side: Side) -> ManoHand:
    """MANO's hand of a side, as the table of hand models names it. Raises `Absent` if the user has no such file."""
    path = find_mano(side)
    right = None
    if side == "left":
        with suppress(Absent):
            right = read_mano(find_mano("right"))
    return ManoHand(read_mano(path), side, layout=read_layout(path.parent, side), right=right)
