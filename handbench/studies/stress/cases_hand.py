"""The shipped hand model: poses beyond the joints' limits, odd shapes, gradients where rotations vanish."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...errors import InputError
from ...hand import HandModel, hand_model
from ...hand.collision import penetration
from ...hand.skinning import rotation_matrix
from ...scene import Array, Pose
from .case import Case
from .judgement import TruthPair, accurate, equal, finite, finite_or, refused

FAMILY = "hand"


def cases() -> Iterator[Case]:
    for name, joints in _poses().items():
        within = 1e-3 if "turns" in name else 1e-5  # float32 holds an angle of 628 to 3e-5 radians, bone after bone
        yield Case(FAMILY, f"pose {name}", accurate(within), partial(_skinned, joints), "torch float64, same code")
        yield Case(FAMILY, f"gradient, pose {name}", finite(), partial(_gradient, joints))
    yield Case(FAMILY, "1 km from the origin", equal(1e-4), _shifted, "at the origin")
    yield Case(FAMILY, "a turn by 2 pi", equal(1e-5), _whole_turn, "no turn")
    for name, shape in _shapes().items():
        yield Case(FAMILY, f"shape of {name}", finite(), partial(_shaped, shape))
    for name, angle in {"0": 0.0, "1e-20": 1e-20, "1e-4": 1e-4, "pi": np.pi, "1e4": 1e4}.items():
        yield Case(
            FAMILY, f"rotation by {name} is orthogonal", equal(1e-5), partial(_orthogonal, angle), "the identity"
        )
        yield Case(FAMILY, f"gradient, rotation by {name}", finite(), partial(_rotation_gradient, angle))
    for dtype in (torch.float16, torch.bfloat16):
        name = str(dtype).removeprefix("torch.")
        yield Case(FAMILY, name, finite_or(InputError), partial(_skin, _hand().named_pose("fist").joints, dtype))
    for name, run in _broken().items():
        yield Case(FAMILY, name, refused(InputError), run)
    yield Case(FAMILY, "a fist bent too far runs into itself", equal(), _collides, "penetration")


def _hand() -> HandModel:
    return hand_model()


def _skin(joints: Array, dtype: torch.dtype) -> Tensor:
    return _hand().skin(_hand().neutral(), joints, dtype=dtype)


def _poses() -> dict[str, Array]:
    fist = _hand().named_pose("fist").joints
    rng = np.random.default_rng(0)
    return {
        "rest": np.zeros_like(fist),
        "fist bent twice as far": 2.0 * fist,
        "bent backwards": -fist,
        "all joints by pi": np.full_like(fist, np.pi / np.sqrt(3)),
        "all joints by 1e-12": np.full_like(fist, 1e-12),
        "all joints by 100 turns": np.full_like(fist, 200 * np.pi / np.sqrt(3)),
        "random beyond all limits": rng.uniform(-np.pi, np.pi, fist.shape),
        "sampled": _hand().sample_pose(rng).joints,
    }


def _skinned(joints: Array) -> TruthPair:
    """Errors are measured against 10 cm at least, about the size of a hand."""
    given = joints.astype(np.float32)
    return TruthPair(_skin(given, torch.float32), _skin(given, torch.float64), least=0.1)


def _gradient(joints: Array) -> tuple[Any, ...]:
    inputs = [torch.tensor(joints, dtype=torch.float32), torch.zeros(3), torch.zeros(3)]
    for value in inputs:
        value.requires_grad_()
    joints_of, rotation, translation = inputs
    _hand().skin(_hand().neutral(), joints_of, rotation, translation).square().sum().backward()
    return tuple(value.grad for value in inputs)


def _shifted() -> TruthPair:
    pose = _hand().named_pose("fist")
    far = _hand().mesh(_hand().neutral(), Pose(pose.joints, pose.rotation, np.full(3, 1000.0)), level=1)
    return TruthPair(far.vertices - 1000.0, _hand().mesh(_hand().neutral(), pose, level=1).vertices)


def _whole_turn() -> TruthPair:
    joints = _hand().named_pose("fist").joints
    turned = _hand().skin(_hand().neutral(), joints, rotation=(0.0, 2 * np.pi, 0.0))
    return TruthPair(turned, _skin(joints, torch.float32), least=0.1)


def _shapes() -> dict[str, Array]:
    neutral, rng = np.asarray(_hand().neutral()), np.random.default_rng(6)
    sampled = np.asarray(_hand().sample_identity(rng))
    return {"a random adult": sampled, "20 times as far from the mean": neutral + 20.0 * (sampled - neutral)}


def _shaped(shape: Array) -> Array:
    return _hand().mesh(shape, _hand().named_pose("fist"), level=1).vertices


def _orthogonal(angle: float) -> TruthPair:
    turn = rotation_matrix(torch.tensor([0.6, 0.0, 0.8]) * angle)
    return TruthPair(turn @ turn.T, torch.eye(3), least=1.0)


def _rotation_gradient(angle: float) -> Tensor | None:
    vector = (torch.tensor([0.6, 0.0, 0.8]) * angle).requires_grad_()
    (rotation_matrix(vector) * torch.arange(9.0).view(3, 3)).sum().backward()
    return vector.grad


def _broken() -> dict[str, Callable[[], Any]]:
    neutral = np.asarray(_hand().neutral())
    joints = _hand().named_pose("fist").joints
    poisoned = joints.copy()
    poisoned[3, 0] = np.nan
    return {
        "pose with NaN": lambda: Pose(poisoned),
        "pose with infinity": lambda: Pose(joints, np.full(3, np.inf)),
        "NaN in skinning": lambda: _skin(poisoned, torch.float32),
        "NaN in skinning as a tensor": lambda: _hand().skin(neutral, torch.tensor(poisoned)),
        "pose of too few joints": lambda: _skin(joints[:-1], torch.float32),
        "shape with NaN": lambda: _hand().rest(neutral * np.nan),
        "shape with infinity": lambda: _hand().rest(neutral + np.inf),
        "shape of too few numbers": lambda: _hand().rest(neutral[:-1]),
        "no shape": lambda: _hand().rest(neutral[:0]),
        "level 5": lambda: _hand().topology(5),
        "level -1": lambda: _hand().topology(-1),
        "unknown pose": lambda: _hand().named_pose("fits"),
        "pose sampled 2 times as strong": lambda: _hand().sample_pose(np.random.default_rng(0), 2.0),
    }


def _collides() -> TruthPair:
    """The named fist is free; bent twice as far it is not."""
    fist = _hand().named_pose("fist").joints
    free = [penetration(_hand(), _skin(k * fist, torch.float64).numpy()).free for k in (1.0, 2.0)]
    return TruthPair(free, [True, False])
