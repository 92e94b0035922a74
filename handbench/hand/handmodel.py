"""What a hand model is, whoever made it: a skeleton, a space of shapes, and a surface that both move."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from ..errors import InputError
from ..scene import Array, Mesh, Pose, Topology
from .skinning import linear_blend, rotation_matrix
from .watched import Watched

Side: TypeAlias = Literal["left", "right"]


class HandModel(ABC):
    """A hand that shape and pose tell completely, in metres, with the wrist at the origin of canonical space.

    The structure is that of MANO: vertices = shape space + pose blend shapes + linear blend skinning, joints turned by
    axis-angles. V coarse vertices, J joints, five fingers; *points* (J + 5, 3) are the joints, then the finger tips.
    A model sets these in its constructor:

    name            as it is registered
    side            "left" or "right"
    joint_names     (J,) in the order of poses
    parents         (J,) the joint each hangs on, before it in order; -1 for the root
    wrist           the wrist's joint: what hangs above it is forearm, what hangs on it palm
    fingers         five names, thumb first
    chains          of each finger its three joints, from the palm to the tip
    ends            (J,) the point at which each joint's bone ends
    frames          (J, 3, 3) columns: the axes in which a joint's axis-angle has its components (MANO: identity)
    points          (J + 5, 3) of the neutral hand at rest
    shape_size      S, how many numbers a shape has (MANO: 10)
    levels          how often the coarse surface can be subdivided (MANO: 0)
    pose_shapes     (V, 3, 9 (J - 1)) displacement per element of R - I, row by row, of all joints but the root (MANO:
                    135), or None
    tip_vertices    five coarse vertices that are the finger tips, or None if bones end in the tips
    limits          (J, 3, 2) radians: least and greatest of each component of the axis-angles, or None (MANO: none)
    """

    name: str
    side: Side
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    wrist: int
    fingers: tuple[str, ...]
    chains: tuple[tuple[int, int, int], ...]
    ends: Array
    frames: Array
    points: Array
    shape_size: int
    levels: int
    pose_shapes: Array | None = None
    tip_vertices: tuple[int, ...] | None = None
    limits: Array | None = None

    @cached_property
    def kept(self) -> Watched:
        """What is worked out of this hand once, for all who use it: `hand.kept(key, make)`."""
        return Watched(HandModel)

    # -- shapes and poses -------------------------------------------------------------------------------------------

    @abstractmethod
    def neutral(self) -> ArrayLike:
        """The shape (S,) of the mean adult."""

    @abstractmethod
    def sample_identity(self, rng: np.random.Generator) -> ArrayLike:
        """The shape (S,) of a random adult; the same seed gives the same one."""

    @abstractmethod
    def sample_pose(self, rng: np.random.Generator, amount: float = 1.0) -> Pose:
        """A random natural pose placed at the origin; `amount` in [0, 1] scales its angles towards rest."""

    @abstractmethod
    def named_pose(self, name: str) -> Pose:
        """A pose by name, at least "rest", placed at the origin; `InputError` for a name that is not known."""

    # -- the surface ------------------------------------------------------------------------------------------------

    @abstractmethod
    def rest_points(self, shape: Tensor | ArrayLike, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
        """Coarse vertices (V, 3) and points (J + 5, 3) of a shape at rest, wrist at the origin.

        Differentiable in a shape that is a tensor. Raises `InputError` for a wrong size and for NaN.
        """

    @abstractmethod
    def rest_position(self, level: int) -> Array:
        """Vertices (V_level, 3) of the neutral hand at rest."""

    @abstractmethod
    def weights(self, level: int) -> Array:
        """Skinning weights (V_level, J), not negative; rows sum to one."""

    @abstractmethod
    def topology(self, level: int) -> Topology:
        """Triangles, UVs and triangles into UVs of a level; the same object every time."""

    @abstractmethod
    def edges(self) -> Array:
        """Pairs (E, 2) of neighbouring coarse vertices; any order, repeats allowed."""

    @abstractmethod
    def subdivide(self, vertices: Tensor, level: int) -> Tensor:
        """Coarse values (V, C) to (V_level, C), linear and differentiable; level 0 changes nothing."""

    # -- what follows -----------------------------------------------------------------------------------------------

    @property
    def key_points(self) -> tuple[int, ...]:
        """The usual 21 among the points: wrist, then of each finger its three joints and its tip, thumb first."""
        joints = len(self.joint_names)
        return (self.wrist, *(p for f, chain in enumerate(self.chains) for p in (*chain, joints + f)))

    @property
    def point_weights(self) -> Array:
        """Skinning weights (J + 5, J) of the points: each goes with its joint, a tip with its finger's last."""
        carriers = [*range(len(self.joint_names)), *(chain[-1] for chain in self.chains)]
        return np.eye(len(self.joint_names))[carriers]

    def rest(self, shape: Tensor | ArrayLike, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
        """Coarse vertices (V, 3) and joints (J, 3) of a shape at rest."""
        vertices, points = self.rest_points(shape, dtype)
        return vertices, points[: len(self.joint_names)]

    def skin(
        self,
        shape: Tensor | ArrayLike,
        joint_rotations: Tensor | ArrayLike,
        rotation: Tensor | ArrayLike = (0.0, 0.0, 0.0),
        translation: Tensor | ArrayLike = (0.0, 0.0, 0.0),
        dtype: torch.dtype = torch.float32,
    ) -> Tensor:
        """Coarse vertices (V, 3) of a posed shape: v -> R (linear blend skinning of v) + t.

        joint_rotations (J, 3) axis-angle in the joints' frames; rotation (3,) axis-angle about the wrist at rest and
        translation (3,) in metres place the hand in the world. A tensor argument sets the dtype and is
        differentiated through. Raises `InputError` for wrong shapes and for NaN.
        """
        for given in (shape, joint_rotations, rotation, translation):
            if isinstance(given, Tensor):
                dtype = given.dtype
        vertices, points = self.rest_points(shape, dtype)
        turns = vector("joint_rotations", joint_rotations, (len(self.parents), 3), dtype)
        placed = (vector("rotation", rotation, (3,), dtype), vector("translation", translation, (3,), dtype))
        frames = torch.tensor(self.frames, dtype=dtype)
        if self.pose_shapes is not None:
            vertices = vertices + self._pose_offsets(turns, frames)
        weights = torch.tensor(self.weights(0), dtype=dtype)
        return linear_blend(vertices, points[: len(turns)], self.parents, weights, frames, turns, *placed)

    def posed(self, shape: Tensor | ArrayLike, pose: Pose) -> tuple[Array, Array]:
        """Coarse vertices (V, 3) and points (J + 5, 3) of a posed shape in the world, exact to float64."""
        vertices = self.skin(shape, pose.joints, pose.rotation, pose.translation, torch.float64)
        _, points = self.rest_points(shape, torch.float64)
        count = len(self.parents)
        weights, frames, *placed = (
            torch.tensor(values)
            for values in (self.point_weights, self.frames, pose.joints, pose.rotation, pose.translation)
        )
        moved = linear_blend(points, points[:count], self.parents, weights, frames, *placed)
        if self.tip_vertices is not None:
            moved[count:] = vertices[list(self.tip_vertices)]
        return vertices.numpy(), moved.numpy()

    def mesh(self, shape: Tensor | ArrayLike, pose: Pose, level: int) -> Mesh:
        """The posed surface of a level as numpy, exact to float64."""
        coarse = self.skin(shape, pose.joints, pose.rotation, pose.translation, torch.float64)
        return Mesh(self.subdivide(coarse, level).numpy(), self.topology(level))

    def _pose_offsets(self, turns: Tensor, frames: Tensor) -> Tensor:
        """What the pose blend shapes add to the vertices at rest, (V, 3)."""
        turned = [j for j, parent in enumerate(self.parents) if parent >= 0]
        local = frames @ rotation_matrix(turns) @ frames.transpose(-1, -2)
        bent = (local - torch.eye(3, dtype=turns.dtype))[turned].flatten()
        return torch.tensor(self.pose_shapes, dtype=turns.dtype) @ bent


def vector(name: str, value: Tensor | ArrayLike, shape: tuple[int, ...], dtype: torch.dtype) -> Tensor:
    """A value as a finite tensor of this shape. Raises `InputError` that says `name` and what is wrong."""
    tensor = value if isinstance(value, Tensor) else torch.tensor(np.asarray(value, dtype=np.float64), dtype=dtype)
    if tuple(tensor.shape) != shape:
        raise InputError(f"hand: {name} has shape {tuple(tensor.shape)}, expected {shape}")
    if not torch.isfinite(tensor).all():
        raise InputError(f"hand: {name} holds NaN or infinity; give finite values")
    return tensor.to(dtype)
