"""The open hand: a shape space, a skeleton and a subdivision surface over one template."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from ...errors import InputError, unknown_name
from ...scene import Pose, Topology
from .. import subdivision
from ..handmodel import HandModel, Side, vector
from ..known import hand_model
from ..skinning import proportion
from .anatomy import bone_ends, joint_frames, joint_limits
from .identity import Identity
from .poses import named_pose, sample_pose
from .template import FINGERS, Template, load_template

SHORTEST, LONGEST = 0.16, 0.21  # wrist to middle finger tip of adults, metres


class OpenHand(HandModel):
    """A right hand in canonical space: metres, wrist at the origin, +y to the middle tip, palm to +z, thumb to +x.

    A shape is an `Identity`, or its numbers as one vector. Vertices of level l are those of l Catmull–Clark steps on
    the posed coarse mesh; UVs are subdivided linearly, so a point of the skin keeps its UV at every level. Axis-angle
    components are explained in `handbench.hand.openhand.anatomy`.
    """

    name = "openhand"
    side: Side = "right"
    fingers = FINGERS
    levels = 4

    def __init__(self, template: Template) -> None:
        self.template = template
        self.joint_names = names = template.joint_names
        self.parents = template.parents
        self.wrist = names.index("wrist")
        self.chains = tuple((names.index(f"{f}1"), names.index(f"{f}2"), names.index(f"{f}3")) for f in FINGERS)
        self.shape_names = template.shape_names
        self.shape_size = len(template.shape_names) + 2 * len(names)
        self.points = template.points
        self.ends = bone_ends(template)
        self.frames = joint_frames(template)
        self.limits: NDArray[Any] = joint_limits(names)

    @staticmethod
    def load() -> OpenHand:
        """The open hand in the package: the one shared object, see `handbench.hand.hand_model`."""
        return cast(OpenHand, hand_model("openhand"))

    # -- identities ---------------------------------------------------------------------------------------------

    def neutral(self) -> Identity:
        """The mean adult."""
        ones = np.ones(len(self.joint_names))
        return Identity(np.zeros(len(self.shape_names)), ones, ones)

    def sample_identity(self, rng: np.random.Generator) -> Identity:
        """A random adult; wrist to middle tip is brought into 16–21 cm by scaling the whole hand."""
        names, joints = self.shape_names, self.joint_names
        spread = np.array([1.0 if name.startswith("pca") else NAMED_SPREAD[name] for name in names])
        blend = spread * np.clip(rng.standard_normal(len(names)), -2, 2)
        fingers = {name.rstrip("0123"): rng.normal(0, [0.025, 0.03]) for name in joints}
        own = rng.normal(0, 0.015, (len(joints), 2))
        factor = np.exp(np.clip([fingers[name.rstrip("0123")] for name in joints] + own, -0.1, 0.1))
        identity = Identity(blend, factor[:, 0], factor[:, 1])
        length = self.length(identity)
        return identity.scaled(float(np.clip(length, SHORTEST, LONGEST)) / length)

    def sample_pose(self, rng: np.random.Generator, amount: float = 1.0) -> Pose:
        return sample_pose(rng, amount)

    def named_pose(self, name: str) -> Pose:
        return named_pose(name)

    def length(self, identity: Identity) -> float:
        """Wrist to middle finger tip in the rest pose, metres."""
        _, points = self.rest_points(identity, torch.float64)
        return float(points[len(self.joint_names) + 2].norm())

    def rest_points(self, shape: Tensor | ArrayLike, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
        blend, length, width = self._parts(shape, dtype)
        vertices = self._tensor("vertices", dtype) + torch.tensordot(blend, self._tensor("shapes", dtype), 1)
        points = self._tensor("points", dtype) + torch.tensordot(blend, self._tensor("point_shapes", dtype), 1)
        ends = torch.tensor(self.ends)
        return proportion(vertices, points, ends, self.parents, self._tensor("weights", dtype), length, width)

    def _parts(self, shape: Tensor | ArrayLike, dtype: torch.dtype) -> tuple[Tensor, ...]:
        """Blend coefficients (B,), lengths and widths of the bones (J,) of a shape."""
        sizes = [len(self.shape_names), len(self.joint_names), len(self.joint_names)]
        if not isinstance(shape, Identity):
            return vector("shape", shape, (self.shape_size,), dtype).split(sizes)
        names = ("blend", "bone_length", "bone_width")
        return tuple(
            vector(f"identity {name}", getattr(shape, name), (size,), dtype)
            for name, size in zip(names, sizes, strict=True)
        )

    # -- surface ------------------------------------------------------------------------------------------------

    def subdivide(self, vertices: Tensor, level: int) -> Tensor:
        """Catmull–Clark: coarse (V, C) to (V_level, C), differentiable."""
        coarse = len(self.template.vertices)
        if vertices.ndim != 2 or len(vertices) != coarse:
            raise InputError(f"subdivide: vertices have shape {tuple(vertices.shape)}, expected ({coarse}, n)")
        for step in range(1, self._level(level) + 1):
            vertices = torch.sparse.mm(self._matrix(step, vertices.dtype, vertices.device), vertices)
        return vertices

    def topology(self, level: int) -> Topology:
        """Triangles, UVs and triangles into UVs of a level."""

        def build() -> Topology:
            uvs, quads = self.template.uvs, self.template.uv_quads
            for _ in range(level):
                step = subdivision.linear_step(quads, len(uvs))
                uvs, quads = step.matrix @ uvs, step.quads
            return Topology(subdivision.triangles(self.quads(level)), uvs, subdivision.triangles(quads))

        return self.kept(("topology", self._level(level)), build)

    def quads(self, level: int) -> NDArray[Any]:
        """Quads (4^level Q, 4) of a level."""
        return self.template.quads if self._level(level) == 0 else self._step(level).quads

    def edges(self) -> NDArray[Any]:
        quads = self.quads(0)
        return np.concatenate([quads[:, [i, (i + 1) % 4]] for i in range(4)])

    # -- maps over the surface ----------------------------------------------------------------------------------

    def vertex_map(self, name: str, level: int) -> NDArray[Any]:
        """A scalar per vertex (V_level,) in [0, 1]: "nail"."""
        if name != "nail":
            raise unknown_name("vertex map", name, ["nail"])
        return self._subdivided("nail", level, self.template.nail[:, None])[:, 0]

    def weights(self, level: int) -> NDArray[Any]:
        """Skinning weights (V_level, J) carried to a level; rows sum to one."""
        return self._subdivided("weights", level, self.template.weights)

    def rest_position(self, level: int) -> NDArray[Any]:
        """Vertices (V_level, 3) of the neutral hand at rest: one space for object-space noise on every identity."""
        return self._subdivided("rest", level, self.template.vertices)

    # -- inner workings -----------------------------------------------------------------------------------------

    def _tensor(self, name: str, dtype: torch.dtype) -> Tensor:
        return self.kept((name, dtype), lambda: torch.tensor(getattr(self.template, name), dtype=dtype))

    def _step(self, level: int) -> subdivision.Step:
        def build() -> subdivision.Step:
            quads = self.quads(level - 1)
            return subdivision.catmull_clark(quads, int(quads.max()) + 1)

        return self.kept(("step", level), build)

    def _matrix(self, level: int, dtype: torch.dtype, device: torch.device) -> Tensor:
        def build() -> Tensor:
            matrix = self._step(level).matrix.tocoo()
            index = torch.from_numpy(np.stack(matrix.coords))
            values = torch.tensor(matrix.data, dtype=dtype)
            made = torch.sparse_coo_tensor(index, values, matrix.shape, check_invariants=False)
            return made.coalesce().to(device)

        return self.kept(("matrix", level, dtype, device), build)

    def _subdivided(self, name: str, level: int, values: NDArray[Any]) -> NDArray[Any]:
        def build() -> NDArray[Any]:
            fine = values
            for step in range(1, level + 1):
                fine = self._step(step).matrix @ fine
            fine.flags.writeable = False
            return fine

        return self.kept(("map", name, self._level(level)), build)

    def _level(self, level: int) -> int:
        if not 0 <= level <= self.levels:
            raise InputError(f"subdivision level {level} is not in 0…{self.levels}")
        return level


# How far one standard deviation of `sample_identity` moves the named blend shapes (1: MakeHuman's full slider).
NAMED_SPREAD = {
    "hand_scale": 0.03,
    "finger_length": 0.1,
    "finger_diameter": 0.35,
    "finger_distance": 0.3,
    "wrist_circumference": 0.3,
    "forearm_fat": 0.25,
    "forearm_muscle": 0.3,
}


def create() -> OpenHand:
    """The open hand, as the table of hand models names it; one of one's own."""
    return OpenHand(load_template())
