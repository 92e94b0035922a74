"""A small hand with random skin, as `physical` knows it: nothing is trained."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest
import torch

from handbench.avatars.portrait import Portrait
from handbench.avatars.repertoire import Body, Posture, Repertoire
from handbench.hand import hand_model
from handbench.method import Pose
from handbench.methods.reflectance.model import PRESETS, ReflectanceAvatar, ReflectancePrior
from handbench.methods.reflectance.physical import INFO
from handbench.scene import Camera


def camera(name: str = "front", width: int = 24, height: int = 32) -> Camera:
    K = np.array([[1.6 * height, 0, width / 2], [0, 1.6 * height, height / 2], [0, 0, 1]])
    return Camera(name, width, height, K, np.c_[np.diag([1.0, -1.0, -1.0]), [0.0, 0.08, 0.4]])


@pytest.fixture(scope="session")
def portrait() -> Portrait:
    hand = hand_model()
    shape = np.asarray(hand.neutral())
    body = Body(hand.name, shape, 0)
    poses = {"rest": hand.named_pose("rest"), "turned": Pose(hand.named_pose("rest").joints, [0.0, 0.6, 0.0])}
    postures: dict[str, Posture] = {name: body.posture(name, pose) for name, pose in poses.items()}
    cameras = {"front": camera(), "wide": camera("wide", 32, 32)}
    views = (("rest", "front"), ("turned", "wide"))
    prior = ReflectancePrior("physical", "brdf", PRESETS["quick"], (1.0, 0.5, 0.45))
    texture = torch.rand(3, 128, 128, generator=torch.Generator().manual_seed(3)) * 0.3 + 0.1
    avatar = ReflectanceAvatar(texture, prior)
    made = ("quick", asdict(PRESETS["quick"]), prior, avatar, Repertoire("me", postures, cameras, views, body))
    return Portrait("toy", INFO, *made, "a test", "none", "toy")
