"""A method that needs nothing but numpy, and ways for it to go wrong. Runs in this interpreter and in another."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from handbench.checkpoint import checkpoints
from handbench.errors import InputError, NonFinite, Unsupported
from handbench.method import Avatar, Method, MethodInfo, PosedAvatar, Prior, Progress, Recording, silent
from handbench.scene import Environment, Light, Mesh, Prediction, Viewpoint, leaves
from handbench.skips import note, skips


def misbehave(how: str) -> None:
    """What goes wrong, where it is asked to."""
    match how:
        case "hang":
            time.sleep(600)
        case "busy":
            while True:
                pass
        case "exit":
            print("the licence has expired", flush=True)
            os._exit(3)
        case "sys-exit":
            sys.exit("no licence")
        case "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        case "orphan":  # a child keeps every descriptor open while the worker dies
            if (child := os.fork()) == 0:
                time.sleep(600)
            Path(os.environ["ORPHAN"]).write_text(str(child))
            os.kill(os.getpid(), signal.SIGKILL)
        case "garbage":
            _write_everywhere(b"\0\0\0\0\x10\0\0\0" * 4096)
            time.sleep(600)
        case "half":  # the start of a message whose rest never comes
            _write_everywhere((1000).to_bytes(8, "little") + b"{")
            time.sleep(600)
        case "flood":
            while True:
                told = {"dict": {"progress": [1, 2, {"dict": {}}]}}
                _write_everywhere(_message({"gone": [], "content": told, "arrays": []}))
        case "trickle":
            _write_everywhere((1 << 20).to_bytes(8, "little"))
            while True:
                _write_everywhere(b" ")
                time.sleep(0.02)
        case "no-json":
            _write_everywhere((4).to_bytes(8, "little") + b"????")
            time.sleep(600)
        case "deep":
            _write_everywhere((100_000).to_bytes(8, "little") + b"[" * 100_000)
            time.sleep(600)
        case "other":
            _write_everywhere(_message({"gone": [], "content": {"dict": {"bomb": 1}}, "arrays": []}))
            time.sleep(600)
        case "huge":
            _write_everywhere(_message({"gone": [], "content": 1, "arrays": [["<f8", [1 << 50]]]}))
            time.sleep(600)
        case "memory":
            raise MemoryError
        case "gpu":
            raise RuntimeError("CUDA out of memory. Tried to allocate 2 GiB")
        case "key":
            raise KeyError("weights")
        case "file":
            Path("/no/such/file").read_text()
        case "unsupported":
            raise Unsupported("no such light here")
        case "non-finite":
            raise NonFinite("the texture overflowed")
        case "noise":
            os.write(1, b"\xff\0 loading \n" * 1000)
            print("epoch 1", file=sys.stderr)
            subprocess.run([sys.executable, "-c", "print('from a child')"], check=True)


def _message(header: dict[str, Any]) -> bytes:
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text


def _write_everywhere(data: bytes) -> None:
    for descriptor in range(3, 256):
        try:
            os.write(descriptor, data)
        except OSError:
            continue


class RemoteAvatar(Avatar):
    def __init__(self, gain: float, paint: np.ndarray, wrong: dict[str, str]) -> None:
        self._gain, self._paint, self._wrong = gain, paint, wrong

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        size = float(np.linalg.norm(viewpoint.mesh.vertices)) * viewpoint.camera.K[0, 0]
        paint = self._gain * self._paint * np.float32(size)
        wrong = self._wrong.get("relight", "") if viewpoint.pose_name == "pose-2" else ""
        return PosedRemote(paint, viewpoint.mesh, wrong)


class PosedRemote(PosedAvatar):
    def __init__(self, paint: np.ndarray, mesh: Mesh, wrong: str) -> None:
        self._paint, self._mesh, self._wrong = paint, mesh, wrong

    def relight(self, light: Light) -> Prediction:
        misbehave(self._wrong)
        note("lights", 3, 2 if skips().dark_lights else 0)
        means = [
            leaf.radiance.mean((0, 1)) if isinstance(leaf, Environment) else leaf.irradiance for leaf in leaves(light)
        ]
        image = np.sum(means, axis=0) * self._paint
        return Prediction(image, np.ones(image.shape[:2]), depth=_Drawn(image.shape[:2]), mesh=self._mesh)


class _Drawn:
    """A depth map that is worked out when numpy asks."""

    drawn = 0

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape = shape

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        _Drawn.drawn += 1
        return np.full(self.shape, float(_Drawn.drawn), dtype)


class RemotePrior(Prior):
    def __init__(self, gain: float, wrong: dict[str, str]) -> None:
        self.gain, self._wrong = gain, wrong

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        misbehave(self._wrong.get("personalise", ""))
        paint = np.mean([enrolment.observe(frame).image for frame in enrolment.frames], axis=0)
        return RemoteAvatar(self.gain, paint, self._wrong)

    def save(self, folder: Path) -> None:
        misbehave(self._wrong.get("save", ""))
        (folder / "gain.json").write_text(json.dumps(self.gain))


class Remote(Method):
    def __init__(self, preset: str, wrong: dict[str, str]) -> None:
        if preset == "fast":
            raise InputError("unknown preset 'fast'; known: quick")
        self._wrong = wrong
        lights = frozenset({"directional", "environment"})
        self.info = MethodInfo("remote", "Remote", "for tests", universal=True, linear=True, lights=lights)

    @property
    def config(self) -> dict[str, Any]:
        return {"wrong": self._wrong, "nested": [1, 2.5, None, {"same": 3}]}

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        misbehave(self._wrong.get("train", ""))
        state = checkpoints()
        if state is not None:
            state.folder.mkdir(parents=True, exist_ok=True)
            (state.folder / "step").write_text("1")
            state.earlier_s = 7.0
        rng = np.random.default_rng(seed)
        total = 0.0
        for i, frame in enumerate(recording.frames):
            total += float(recording.observe(frame).image.sum(dtype=np.float64)) * rng.uniform(0.5, 1.0)
            progress(i + 1, len(recording.frames), loss=np.float32(total))
        return RemotePrior(total / (1 + len(recording.frames)), self._wrong)

    def load(self, folder: Path) -> Prior:
        misbehave(self._wrong.get("load", ""))
        return RemotePrior(json.loads((folder / "gain.json").read_text()), self._wrong)


def create(preset: str = "quick", **wrong: str) -> Method:
    misbehave(wrong.get("create", ""))
    return Remote(preset, wrong)


def create_with_old_torch(preset: str = "quick") -> Method:
    """Needs a torch that no other method could live with, and is told if it sees packages that are not its own."""
    import torch

    if torch.__version__ != "0.4.1":
        raise ImportError(f"torch {torch.__version__} is too new")
    for name in ("scipy", "jax", "mitsuba"):
        try:
            __import__(name)
        except ImportError:
            continue
        raise ImportError(f"{name} of the other interpreter is in sight")
    return Remote(preset, {})
