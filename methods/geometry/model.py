"""The autoencoder as one module: who a hand is, how it is posed, and the surface that follows.

Networks and geometry are on one device; scans, pictures and poses come from the CPU. All lengths are metres; key
points are those of `skeleton`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor, nn

from handbench.hand import HandModel
from handbench.hand.skinning import rotation_matrix
from handbench.scene import Array, Camera, Pose

from ..kit.host import on_host
from ..kit.layers import channels_last
from .config import GeometryConfig
from .networks import OFFSET, IdentityDecoder, IdentityEncoder, PoseDecoder, PoseEncoder, principal
from .scan import PointCloud, depth_maps
from .skeleton import ToldPose, bone_weights, forward, pose_told_by

_NEAR, _FAR = 0.004, 0.1  # metres that count as one: joints about the template's, joints about the wrist


@dataclass(frozen=True, eq=False)
class Shape:
    """A hand at rest: code (Z,), coarse vertices (V, 3) and key points (P, 3), and the vertices' offsets (V, 3)."""

    code: Tensor
    vertices: Tensor
    points: Tensor
    offsets: Tensor


@dataclass(frozen=True, eq=False)
class DecodedHand:
    """A posed hand in the world: vertices (V_level, 3), key points (P, 3), and the pose correctives (V, 3)."""

    vertices: Tensor
    points: Tensor
    correctives: Tensor


class GeometryModel(nn.Module):
    """E_id, D_id, E_theta and D_theta (URHand supp. Fig. 3) around a hand model, whose neutral hand they correct."""

    def __init__(self, config: GeometryConfig, hand: HandModel, level: int) -> None:
        super().__init__()
        self.config, self.hand, self.level = config, hand, level
        neutral = hand.rest_position(0)
        points, joints, vertices = len(hand.points), len(hand.parents), len(neutral)
        self.identity_encoder = IdentityEncoder(points, config.code)
        self.identity_decoder = IdentityDecoder(config.code, points, vertices)
        self.pose_encoder = PoseEncoder(points, joints)
        self.pose_decoder = PoseDecoder(joints, config.code, vertices)
        channels_last(self)
        free = torch.ones(joints + 2, 1)
        free[hand.parents.index(-1)] = 0.0  # the rigid placement of the hand moves the root
        # of the hand, so not saved with what is learned
        self.register_buffer("_vertices", torch.tensor(neutral).float(), persistent=False)
        self.register_buffer("_points", torch.tensor(hand.points).float(), persistent=False)
        weights = np.concatenate([hand.weights(0), hand.point_weights])
        self.register_buffer("_weights", torch.tensor(weights).float(), persistent=False)
        self.register_buffer("_bones", torch.tensor(bone_weights(hand)).float(), persistent=False)
        self.register_buffer("_free", free, persistent=False)
        self.register_buffer("still", torch.zeros(joints + 2, 3), persistent=False)

    _vertices: Tensor
    _points: Tensor
    _weights: Tensor
    _bones: Tensor
    _free: Tensor
    still: Tensor
    """What `beyond` says when a picture adds nothing."""

    def here(self, values: Array) -> Tensor:
        """Values as a tensor on the model's device, float32."""
        return torch.tensor(values).float().to(self._points.device)

    @staticmethod
    def _run(network: nn.Module, *inputs: Tensor) -> tuple[Tensor, ...]:
        """A network on single inputs without a batch axis."""
        found = network(*(x[None] for x in inputs))
        return tuple(x[0] for x in (found if isinstance(found, tuple) else (found,)))

    def start(self, hands: Sequence[Array]) -> None:
        """Begin with the joints' principal components of neutral hands in the reference frame, each (P, 3)."""
        near = self.here(np.stack(hands)).sub(self._points) / _NEAR
        principal(self.identity_encoder, self.identity_decoder, near, _NEAR)

    def encode(self, aligned: PointCloud, points: Array) -> tuple[Tensor, Tensor]:
        """Mean and log variance (Z,) of the identity code of a neutral hand in the reference frame."""
        near = (self.here(points) - self._points) / _NEAR
        maps = depth_maps(aligned, self.config.depth).to(near.device)
        mean, log_variance = self._run(self.identity_encoder, maps, near)
        return mean, log_variance

    def shape(self, code: Tensor) -> Shape:
        """The hand of a code at rest: bones carry their vertices, the wrist stays at the origin."""
        joints, vertices = self._run(self.identity_decoder, code)
        joints = joints - joints[self.hand.wrist]
        return Shape(code, self._vertices + self._bones @ joints + vertices, self._points + joints, vertices)

    def beyond(self, picture: Tensor, camera: Camera, observed: Array, told: ToldPose) -> Tensor:
        """What a picture adds to the pose that its key points (P, 3) tell: (J + 2, 3) radians, the last one metres."""
        seen = (observed - observed[self.hand.wrist]) @ camera.rotation.T
        positions, joints = self.here(seen / _FAR), told.joints.float()
        (found,) = self._run(self.pose_encoder, picture.to(joints.device), positions, joints)
        found = found * self._free
        return torch.cat([found[:-1], OFFSET * found[-1:]])

    def told(self, shape: Shape, observed: Array) -> ToldPose:
        """The pose that key points (P, 3) tell of this hand in closed form; not differentiated through."""
        points = shape.points.detach().double()
        return pose_told_by(self.hand, points, torch.tensor(observed, dtype=points.dtype, device=points.device))

    def posed(self, shape: Shape, told: ToldPose, beyond: Tensor) -> DecodedHand:
        """Template + identity and pose correctives, linear blend skinning, subdivision to the capture's level."""
        joints = told.joints.float() + beyond[:-2]
        (correctives,) = self._run(self.pose_decoder, joints, shape.code)
        carried = torch.cat([shape.vertices + correctives, shape.points])
        skinned = forward(self.hand, carried, shape.points, self._weights, joints, beyond[-2], beyond[-1])
        placed = skinned @ told.rotation.float().T + told.translation.float()
        count = len(shape.vertices)
        return DecodedHand(self.hand.subdivide(placed[:count], self.level), placed[count:], correctives)


def combined(told: ToldPose, beyond: Tensor) -> Pose:
    """The whole pose: v -> R (exp(turn) skinned + shift) + t as one placement."""
    extra = beyond.double()
    rotation = Rotation.from_matrix(on_host(told.rotation @ rotation_matrix(extra[-2]))).as_rotvec()
    moved = told.rotation @ extra[-1] + told.translation
    return Pose(on_host(told.joints + extra[:-2]), rotation, on_host(moved))
