"""A capture of 8 x 8 pixels and methods that obey or break one law each, for the tests of the bench."""

from __future__ import annotations

import errno
import json
import zlib
from collections import Counter
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from handbench.data.capture import Capture
from handbench.errors import InputError, NonFinite, Unsupported
from handbench.method import Avatar, Method, MethodInfo, PosedAvatar, Prior, Progress, Recording, silent
from handbench.scene import (
    Camera,
    Directional,
    Environment,
    Frame,
    Light,
    Mesh,
    Observation,
    Pose,
    Prediction,
    Topology,
    Unknown,
    Viewpoint,
    leaves,
)

CALLS: Counter[str] = Counter()
STOP_AT: dict[str, int] = {}  # method name to the relight call that a user interrupts

_TOPOLOGY = Topology([[0, 1, 2]], [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
_EYE = np.eye(3, 4)
_OLATS = [Directional([0.6, 0, 0.8], [0.1] * 3), Directional([-0.6, 0, 0.8], [0.2] * 3)]
_OLATS += [Directional([0, 0.6, 0.8], [0.3] * 3), Directional([0, -0.6, 0.8], [0.4] * 3)]
_LIGHTS: dict[str, tuple[str, Light]] = {
    **{f"olat-{i:02d}": ("olat", light) for i, light in enumerate(_OLATS)},
    "group-0": ("group", Directional([0, 1, 0], [0.6] * 3)),
    "full": ("full", Directional([1, 0, 0], [1.0] * 3)),
    "env-park": ("environment", Environment("park", np.full((2, 4, 3), 0.2))),
}


class ToyCapture(Capture):
    name = "toy-8"

    def __init__(self, digest: str = "toy-digest", damaged: str = "") -> None:
        self.digest = digest
        self._damaged = damaged
        cameras = [Camera(name, 8, 8, [[8, 0, 4], [0, 8, 4], [0, 0, 1]], _EYE) for name in ("front", "side")]
        poses = (("pose-0", "train"), ("pose-1", "train"), ("pose-2", "held-out"))
        self._frames = tuple(
            Frame(subject, pose, lighting, Pose(np.zeros((1, 3))), mesh, camera, light, segment, kind)
            for subject, (pose, segment) in product(("s01", "s02"), poses)
            for mesh in [Mesh(np.eye(3), _TOPOLOGY)]
            for camera, (lighting, (kind, light)) in product(cameras, _LIGHTS.items())
        )

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    def observe(self, frame: Frame) -> Observation:
        CALLS["observe"] += 1
        if frame.key == self._damaged:
            raise InputError(f"image {frame.key}.exr is damaged; make the capture again")
        rng = np.random.default_rng(zlib.crc32(frame.key.encode()))
        alpha = np.zeros((8, 8))
        alpha[1:7, 1:7] = 1
        return Observation(rng.uniform(0.1, 0.9, (8, 8, 3)) * alpha[..., None] * brightness(frame.light), alpha)


def open_toy(size: str = "quick", folder: Path | None = None, progress: Progress = silent) -> Capture:
    CALLS["open"] += 1
    progress(1, 1)
    if size not in ("tiny", "damaged"):
        raise InputError(f"unknown size {size!r}")
    return ToyCapture(damaged="s02/pose-2/front/group-0" if size == "damaged" else "")


def brightness(light: Light) -> np.ndarray:
    return sum(
        (leaf.radiance.mean((0, 1)) if isinstance(leaf, Environment) else leaf.irradiance) for leaf in leaves(light)
    )


class ToyAvatar(Avatar):
    """`own` is the brightness (3,) of the light that it was enrolled under, as it estimates it."""

    def __init__(self, name: str, gain: float, subject: str, own: np.ndarray) -> None:
        self._name, self._gain, self._subject, self._own = name, gain, subject, own
        self._asked = 0

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        return PosedToy(self, viewpoint)

    def draw(self, viewpoint: Viewpoint, light: Light) -> Prediction:
        CALLS[f"{self._name} relight"] += 1
        self._asked += 1
        if STOP_AT.get(self._name) == CALLS[f"{self._name} relight"]:
            raise KeyboardInterrupt
        power = self._own if isinstance(light, Unknown) else brightness(light)
        image = np.full((8, 8, 3), 1.0) * power * self._gain
        alpha = np.ones((8, 8))
        match self._name:
            case "toy-nan" if viewpoint.camera.name == "side":
                image[0, 0] = np.nan
            case "toy-crash" if viewpoint.subject == "s02":
                raise KeyError("weights")
            case "toy-memory":
                raise MemoryError
            case "toy-diverges":
                raise NonFinite("the texture overflowed")
            case "toy-no-environment" if isinstance(light, Environment):
                raise Unsupported("no environment light")
            case "toy-small":
                image, alpha = image[:4], alpha[:4]
            case "toy-square":
                image = image**2
            case "toy-forgetful":
                image = image + 0.01 * self._asked
            case "toy-mutates":
                viewpoint.pose.joints.flags.writeable = True
                viewpoint.pose.joints[:] += 1
        return Prediction(image, alpha)


class PosedToy(PosedAvatar):
    def __init__(self, avatar: ToyAvatar, viewpoint: Viewpoint) -> None:
        self._avatar, self._viewpoint = avatar, viewpoint

    def relight(self, light: Light) -> Prediction:
        return self._avatar.draw(self._viewpoint, light)


class ToyPrior(Prior):
    def __init__(self, name: str, gain: float) -> None:
        self._name, self._gain = name, gain

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        CALLS[f"{self._name} personalise"] += 1
        (subject,) = enrolment.subjects
        kinds = {frame.kind for frame in enrolment.frames}
        CALLS[f"{self._name} enrolled with {'+'.join(sorted(kinds))}"] += 1
        seen = [enrolment.observe(frame) for frame in enrolment.frames]
        own = np.mean([each.image.mean((0, 1)) for each in seen], axis=0)
        return ToyAvatar(self._name, self._gain, subject, own)

    def save(self, folder: Path) -> None:
        if self._name == "toy-full-disk":
            raise OSError(errno.ENOSPC, "No space left on device")
        gain = self._gain * (1.5 if self._name == "toy-lossy" else 1)
        (folder / "gain.json").write_text(json.dumps(gain))


class Toy(Method):
    def __init__(self, name: str, config: dict[str, Any]) -> None:
        linear = name in ("toy", "toy-square")
        lights = frozenset({"directional"} if name == "toy-directional" else {"directional", "environment"})
        universal = name != "toy-identity"
        lights |= {"unknown"} if name == "toy-estimates" else set()
        needs = frozenset({"depth"} if name == "toy-needy" else ())
        about = {"universal": universal, "linear": linear, "lights": lights, "needs": needs}
        self.info = MethodInfo(name, name.title(), "for tests", **about)
        self._config = config

    @property
    def config(self) -> dict[str, Any]:
        return self._config

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        CALLS[f"{self.info.name} train"] += 1
        if self.info.name == "toy-crash-train":
            raise ValueError("no such layer")
        gain = 0.5 + 0.1 * seed
        if self.info.name == "toy-unseeded":
            gain += 0.01 * CALLS["toy-unseeded train"]
        progress(1, 1, loss=gain)
        return ToyPrior(self.info.name, gain)

    def load(self, folder: Path) -> Prior:
        try:
            return ToyPrior(self.info.name, json.loads((folder / "gain.json").read_text()))
        except ValueError as error:
            raise InputError(f"{folder} is damaged; train again") from error


def __getattr__(name: str) -> Any:
    """A factory for every name: "toy_crash" makes the method "toy-crash"."""
    if not name.startswith("toy"):
        raise AttributeError(name)
    method = name.replace("_", "-")

    def create(preset: str = "quick") -> Method:
        CALLS[f"{method} create"] += 1
        if preset == "fast":
            raise InputError("unknown preset 'fast'")
        return Toy(method, {"preset": preset})

    return create
