"""A small hand with random skin, as `physical` knows it: nothing is trained."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from handbench.avatars.portrait import Portrait
from handbench.avatars.repertoire import Body, Posture, Repertoire
from handbench.hand import hand_model
from handbench.method import Pose
from handbench.methods.reflectance.model import PRESETS, ReflectanceAvatar, ReflectanceConfig, ReflectancePrior
from handbench.methods.reflectance.physical import INFO
from handbench.scene import Camera


def camera(name: str = "front", width: int = 24, height: int = 32) -> Camera:
    K = np.array([[1.6 * height, 0, width / 2], [0, 1.6 * height, height / 2], [0, 0, 1]])
    return Camera(name, width, height, K, np.c_[np.diag([1.0, -1.0, -1.0]), [0.0, 0.08, 0.4]])


@pytest.fixture(scope="session")
def portrait() -> Portrait:
    """With few texels, which is fast."""
    return made(replace(PRESETS["quick"], texture=40))


@pytest.fixture(scope="session")
def whole_portrait() -> Portrait:
    """As a preset makes it, which can be kept."""
    return made(PRESETS["quick"])


def made(config: ReflectanceConfig) -> Portrait:
    hand = hand_model()
    shape = np.asarray(hand.neutral())
    body = Body(hand.name, shape, 0)
    poses = {"rest": hand.named_pose("rest"), "turned": Pose(hand.named_pose("rest").joints, [0.0, 0.6, 0.0])}
    postures: dict[str, Posture] = {name: body.posture(name, pose) for name, pose in poses.items()}
    cameras = {"front": camera(), "wide": camera("wide", 32, 32)}
    views = (("rest", "front"), ("turned", "wide"))
    prior = ReflectancePrior("physical", "brdf", config, (1.0, 0.5, 0.45))
    texture = torch.rand(3, config.texture, config.texture, generator=torch.Generator().manual_seed(3)) * 0.3 + 0.1
    avatar = ReflectanceAvatar(texture, prior)
    about = ("quick", asdict(config), prior, avatar, Repertoire("me", postures, cameras, views, body))
    return Portrait("toy", INFO, *about, "a test", "none", "toy")
