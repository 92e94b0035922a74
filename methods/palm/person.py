"""Who a hand belongs to: what personalisation found in a picture, beside networks that are everybody's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from handbench.errors import Unsupported
from handbench.hand import HandModel
from handbench.light.gaussians import SphericalGaussians
from handbench.scene import Pose

from .model import LatentCodes, PalmModel
from .posed import PosedHand

_BEYOND = np.radians(25.0)
"""Of a joint's limit: estimates of poses are off by degrees, and networks that saw no such pose draw anything."""


@dataclass(frozen=True, eq=False)
class Person:
    """One person's codes, shape (S,) of the hand model, and the light that their picture was taken in."""

    model: PalmModel
    codes: LatentCodes
    shape: Tensor
    light: SphericalGaussians

    def posed(self, pose: Pose) -> PosedHand:
        """The hand in a pose. Raises `Unsupported` for what the hand model cannot do."""
        check_pose(self.model.hand, pose)
        placed = (torch.tensor(part, dtype=torch.float32) for part in (pose.joints, pose.rotation, pose.translation))
        return PosedHand(self.model, self.codes, self.shape, *placed)


def check_pose(hand: HandModel, pose: Pose) -> None:
    """Raises `Unsupported` for the pose of another hand model, and for joints far beyond their limits."""
    if len(pose.joints) != len(hand.joint_names):
        raise Unsupported(
            f"the pose has {len(pose.joints)} joints, and PALM-Net's hand ({hand.name}) has {len(hand.joint_names)}"
        )
    if hand.limits is None:
        return
    beyond = np.maximum(hand.limits[..., 0] - pose.joints, pose.joints - hand.limits[..., 1]).max(axis=1)
    worst = int(beyond.argmax())
    if beyond[worst] > _BEYOND:
        raise Unsupported(
            f"the pose bends {hand.joint_names[worst]} {np.degrees(beyond[worst]):.0f} degrees beyond its limit; "
            "give a pose that a hand can take"
        )
