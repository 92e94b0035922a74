"""A method whose work is done by a worker process in another interpreter."""

from __future__ import annotations

import os
import weakref
from collections.abc import Callable
from dataclasses import fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..method import Avatar, Method, MethodInfo, PosedAvatar, Prior, Progress, RecordedAvatar, Recording, silent
from ..scene import Array, Light, Observation, Prediction, Query, Viewpoint
from .process import Limits, Worker, WorkerFailed

_LIMITS = {f"{field.name}_s": field.name for field in fields(Limits)}


@lru_cache(16)
def remote_method(preset: str = "quick", *, python: str, target: str, path: str = "", **settings: str) -> Method:
    """The method that `target`, "module:attribute", makes in the interpreter `python`; the same call, the same method.

    python     the other interpreter; "~" and "$VARIABLE" are expanded. It needs numpy and Python 3.11 or newer
    path       folders in which the module is found, separated as in PATH, beside what that interpreter finds itself
    settings   "train_s" and its like are seconds that a call may take (see `Limits`); all others go to the target

    Raises `InputError` if the interpreter or the target cannot be used.
    """
    chosen = {name: _seconds(name, settings.pop(name)) for name in _LIMITS if name in settings}
    limits = Limits(**{_LIMITS[name]: seconds for name, seconds in chosen.items()})
    folders = tuple(str(_expanded(place).absolute()) for place in path.split(os.pathsep) if place)
    return RemoteMethod(str(_expanded(python)), folders, limits, target, {"preset": preset, **settings})


def _expanded(text: str) -> Path:
    return Path(os.path.expandvars(text)).expanduser()


def _seconds(name: str, text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0.0 < seconds < float("inf"):
        raise InputError(f"setting {name} of a method in another interpreter is {text!r}; give seconds above 0")
    return seconds


class RemoteMethod(Method):
    """Starts its worker when it is made, and again when that has died."""

    def __init__(
        self, python: str, path: tuple[str, ...], limits: Limits, target: str, settings: dict[str, str]
    ) -> None:
        self._start = (python, path, limits)
        self._target, self._settings = target, settings
        self._worker, told = self._started()
        self.info = MethodInfo.of(told["info"])
        self._config = {**told["config"], "interpreter": {"target": target, **told["ran_by"]}}

    @property
    def config(self) -> dict[str, Any]:
        """The method's own, and what runs it: Python, packages that were loaded, a digest of the method's source."""
        return self._config

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        worker = self.worker()
        number = worker.call("train", _replies(recording, progress), frames=recording.frames, seed=seed)
        return RemotePrior(self, worker, number, None)

    def load(self, folder: Path) -> Prior:
        worker = self.worker()
        return RemotePrior(self, worker, worker.call("load", folder=str(folder.absolute())), folder)

    def worker(self) -> Worker:
        """A worker that lives."""
        if not self._worker.alive:
            self._worker, _ = self._started()
        return self._worker

    def _started(self) -> tuple[Worker, dict[str, Any]]:
        worker = Worker(*self._start)
        try:
            return worker, worker.call("create", target=self._target, settings=self._settings)
        except Exception as error:
            worker.end()
            told = f"{type(error).__name__}: {error}" if not isinstance(error, (InputError, WorkerFailed)) else error
            raise InputError(
                f"method {self._target} cannot be made by {self._start[0]} ({told}); mend it, or the entry's settings"
            ) from error


class RemotePrior(Prior):
    """A prior that a worker holds. One that was loaded can be loaded again when its worker has died."""

    def __init__(self, method: RemoteMethod, worker: Worker, number: int, folder: Path | None) -> None:
        self._method, self._folder = method, folder
        self._worker, self._number = worker, number
        weakref.finalize(self, worker.release, number).atexit = False

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        if not self._worker.alive and self._folder is not None:
            return self._method.load(self._folder).personalise(enrolment, seed, progress)
        replies = _replies(enrolment, progress)
        told = _living(self._worker).call(
            "personalise", replies, prior=self._number, frames=enrolment.frames, seed=seed
        )
        made = RemoteRecordedAvatar if told["recorded"] else RemoteAvatar
        return made(_Held(self._worker, told["avatar"]))

    def save(self, folder: Path) -> None:
        _living(self._worker).call("save", prior=self._number, folder=str(folder.absolute()))


class _Held:
    """Something that a worker holds by number until this is gone; it is gone with the worker, too."""

    def __init__(self, worker: Worker, number: int) -> None:
        self.worker, self.number = worker, number
        weakref.finalize(self, worker.release, number).atexit = False

    def call(self, call: str, name: str, **arguments: Any) -> Any:
        """The answer to a call that is told the number under a name."""
        return _living(self.worker).call(call, None, **{name: self.number}, **arguments)

    def prediction(self, told: dict[str, Any]) -> Prediction:
        """A prediction as it was sent, whose maps are fetched when they are asked for."""
        maps = {name: _Map(_Held(self.worker, number), tuple(shape)) for name, (number, shape) in told["maps"].items()}
        return replace(told["prediction"], **maps)


class RemoteAvatar(Avatar):
    """An avatar that a worker holds."""

    def __init__(self, held: _Held) -> None:
        self._held = held

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        return RemotePosedAvatar(_Held(self._held.worker, self._held.call("pose", "avatar", viewpoint=viewpoint)))


class RemotePosedAvatar(PosedAvatar):
    """A posed avatar that a worker holds."""

    def __init__(self, held: _Held) -> None:
        self._held = held

    def relight(self, light: Light) -> Prediction:
        return self._held.prediction(self._held.call("relight", "posed", light=light))


class RemoteRecordedAvatar(RecordedAvatar):
    """An avatar of recorded pictures that a worker holds."""

    def __init__(self, held: _Held) -> None:
        self._held = held

    def relight(self, query: Query) -> Prediction:
        return self._held.prediction(self._held.call("recorded", "avatar", query=query))


class _Map:
    """A depth or normal map that is fetched when numpy asks for it: relighting does not wait for it."""

    def __init__(self, held: _Held, shape: tuple[int, ...]) -> None:
        self._held, self.shape = held, shape

    def __array__(self, dtype: np.dtype | None = None, copy: bool | None = None) -> Array:
        try:
            found = self._held.call("map", "number")
        except WorkerFailed:  # scoring must not stop for it: a map of NaN is a score that is missing
            found = np.full(self.shape, np.nan, np.float32)
        return np.array(found, dtype=dtype, copy=copy)


def _living(worker: Worker) -> Worker:
    if not worker.alive:
        raise WorkerFailed(worker.failure or "the process that held this is gone")
    return worker


def _replies(recording: Recording, progress: Progress) -> dict[str, Callable[[Any], Any]]:
    """What a worker may want while it trains: images of the recording's frames, and to tell how far it is."""
    frames = {frame.key: frame for frame in recording.frames}

    def observe(key: str) -> Observation:
        return recording.observe(frames[key])

    def tell(told: list[Any]) -> None:
        step, total, values = told
        progress(step, total, **values)

    return {"observe": observe, "progress": tell}
