"""The open hand: a shape space, a skeleton and a subdivision surface over one template."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from ..errors import InputError, unknown_name
from ..scene import Mesh, Pose, Topology
from . import subdivision
from .anatomy import bone_ends, joint_frames, joint_limits
from .identity import Identity
from .skinning import linear_blend, proportion
from .template import Template, load_template

MAX_LEVEL = 4
SHORTEST, LONGEST = 0.16, 0.21  # wrist to middle finger tip of adults, metres


class OpenHand:
    """A right hand in canonical space: metres, wrist at the origin, +y to the middle tip, palm to +z, thumb to +x.

    Vertices of level l are those of l Catmull–Clark steps on the posed coarse mesh; UVs are subdivided linearly, so
    a point of the skin keeps its UV at every level. Axis-angle components are explained in `handbench.hand.anatomy`.
    """

    def __init__(self, template: Template) -> None:
        self.template = template
        self.joint_names = template.joint_names
        self.parents = template.parents
        self.shape_names = template.shape_names
        self.frames = joint_frames(template)
        self.limits = joint_limits(template.joint_names)
        self._ends = bone_ends(template)
        self._cache: dict[Any, Any] = {}

    @staticmethod
    @functools.cache
    def load() -> OpenHand:
        """The open hand in the package (one shared object)."""
        return OpenHand(load_template())

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

    def length(self, identity: Identity) -> float:
        """Wrist to middle finger tip in the rest pose, metres."""
        _, points = self._rest(identity, torch.float64)
        return float(points[len(self.joint_names) + 2].norm())

    # -- shape and pose -----------------------------------------------------------------------------------------

    def rest(self, identity: Identity, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
        """Coarse vertices (V, 3) and joints (J, 3) of an identity in the rest pose."""
        vertices, points = self._rest(identity, dtype)
        return vertices, points[: len(self.joint_names)]

    def _rest(self, identity: Identity, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
        blend = self._vector("identity blend", identity.blend, (len(self.shape_names),), dtype)
        length = self._vector("identity bone_length", identity.bone_length, (len(self.joint_names),), dtype)
        width = self._vector("identity bone_width", identity.bone_width, (len(self.joint_names),), dtype)
        vertices = self._tensor("vertices", dtype) + torch.tensordot(blend, self._tensor("shapes", dtype), 1)
        points = self._tensor("points", dtype) + torch.tensordot(blend, self._tensor("point_shapes", dtype), 1)
        ends = torch.from_numpy(self._ends)
        return proportion(vertices, points, ends, self.parents, self._tensor("weights", dtype), length, width)

    def skin(
        self,
        identity: Identity,
        joint_rotations: Tensor | ArrayLike,
        rotation: Tensor | ArrayLike = (0.0, 0.0, 0.0),
        translation: Tensor | ArrayLike = (0.0, 0.0, 0.0),
        dtype: torch.dtype = torch.float32,
    ) -> Tensor:
        """Coarse vertices (V, 3) of a posed identity: v -> R (linear blend skinning of v) + t.

        joint_rotations (J, 3) axis-angle in the joints' frames; rotation (3,) axis-angle about the wrist and
        translation (3,) in metres place the hand in the world. A tensor argument sets the dtype and is
        differentiated through. Raises `InputError` for wrong shapes and for NaN.
        """
        for given in (joint_rotations, rotation, translation):
            if isinstance(given, Tensor):
                dtype = given.dtype
        vertices, joints = self.rest(identity, dtype)
        return linear_blend(
            vertices,
            joints,
            self.parents,
            self._tensor("weights", dtype),
            self._cached(("frames", dtype), lambda: torch.tensor(self.frames, dtype=dtype)),
            self._vector("joint_rotations", joint_rotations, (len(self.joint_names), 3), dtype),
            self._vector("rotation", rotation, (3,), dtype),
            self._vector("translation", translation, (3,), dtype),
        )

    # -- surface ------------------------------------------------------------------------------------------------

    def subdivide(self, vertices: Tensor, level: int) -> Tensor:
        """Catmull–Clark: coarse (V, C) to (V_level, C), differentiable."""
        coarse = len(self.template.vertices)
        if vertices.ndim != 2 or len(vertices) != coarse:
            raise InputError(f"subdivide: vertices have shape {tuple(vertices.shape)}, expected ({coarse}, n)")
        for step in range(1, self._level(level) + 1):
            vertices = torch.sparse.mm(self._matrix(step, vertices.dtype), vertices)
        return vertices

    def topology(self, level: int) -> Topology:
        """Triangles, UVs and triangles into UVs of a level."""

        def build() -> Topology:
            uvs, quads = self.template.uvs, self.template.uv_quads
            for _ in range(level):
                step = subdivision.linear(quads, len(uvs))
                uvs, quads = step.matrix @ uvs, step.quads
            return Topology(subdivision.triangles(self.quads(level)), uvs, subdivision.triangles(quads))

        return self._cached(("topology", self._level(level)), build)

    def quads(self, level: int) -> NDArray[Any]:
        """Quads (4^level Q, 4) of a level."""
        return self.template.quads if self._level(level) == 0 else self._step(level).quads

    def mesh(self, identity: Identity, pose: Pose, level: int = 2) -> Mesh:
        """The posed surface as numpy, exact to float64."""
        coarse = self.skin(identity, pose.joints, pose.rotation, pose.translation, torch.float64)
        return Mesh(self.subdivide(coarse, level).numpy(), self.topology(level))

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

    def _cached(self, key: Any, build: Any) -> Any:
        if key not in self._cache:
            self._cache[key] = build()
        return self._cache[key]

    def _tensor(self, name: str, dtype: torch.dtype) -> Tensor:
        return self._cached((name, dtype), lambda: torch.tensor(getattr(self.template, name), dtype=dtype))

    def _step(self, level: int) -> subdivision.Step:
        def build() -> subdivision.Step:
            quads = self.quads(level - 1)
            return subdivision.catmull_clark(quads, int(quads.max()) + 1)

        return self._cached(("step", level), build)

    def _matrix(self, level: int, dtype: torch.dtype) -> Tensor:
        def build() -> Tensor:
            matrix = self._step(level).matrix.tocoo()
            index = torch.from_numpy(np.stack(matrix.coords))
            return torch.sparse_coo_tensor(
                index, torch.tensor(matrix.data, dtype=dtype), matrix.shape, check_invariants=False
            ).coalesce()

        return self._cached(("matrix", level, dtype), build)

    def _subdivided(self, name: str, level: int, values: NDArray[Any]) -> NDArray[Any]:
        def build() -> NDArray[Any]:
            fine = values
            for step in range(1, level + 1):
                fine = self._step(step).matrix @ fine
            fine.flags.writeable = False
            return fine

        return self._cached(("map", name, self._level(level)), build)

    @staticmethod
    def _level(level: int) -> int:
        if not 0 <= level <= MAX_LEVEL:
            raise InputError(f"subdivision level {level} is not in 0…{MAX_LEVEL}")
        return level

    @staticmethod
    def _vector(name: str, value: Tensor | ArrayLike, shape: tuple[int, ...], dtype: torch.dtype) -> Tensor:
        tensor = value if isinstance(value, Tensor) else torch.tensor(np.asarray(value, dtype=np.float64), dtype=dtype)
        if tuple(tensor.shape) != shape:
            raise InputError(f"hand: {name} has shape {tuple(tensor.shape)}, expected {shape}")
        if not torch.isfinite(tensor).all():
            raise InputError(f"hand: {name} holds NaN or infinity; give finite values")
        return tensor.to(dtype)


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
