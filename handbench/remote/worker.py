"""What runs in the other interpreter: makes the method and answers one call after the other."""

from __future__ import annotations

import importlib
import platform
import sys
from contextlib import ExitStack
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from ..checkpoint import checkpoints_in
from ..device import on_device
from ..method import Avatar, Method, PosedAvatar, Prior, RecordedAvatar
from ..recording import Recording
from ..scene import Array, Frame, Light, Observation, Prediction, Query, Viewpoint
from ..skips import Skips, skipping, tallied
from ..source import source_digest
from .faults import describe, revive
from .wire import Channel, Closed


def serve(channel: Channel) -> None:
    """Answer calls until the other side is gone."""
    desk = _Desk(channel)
    while True:
        try:
            asked = channel.receive()
            try:
                channel.send({"done": desk.answer(**asked)})
            except Closed:
                raise
            except Exception as error:
                channel.send({"error": describe(error)})
        except Closed:
            return


class _Desk:
    """The method, and what the other side holds of it by number: priors, avatars, posed ones, maps of predictions."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._numbers = count()
        self._held: dict[int, Any] = {}
        self._method: Method

    def answer(self, call: str, arguments: dict[str, Any], context: dict[str, Any], release: list[int]) -> Any:
        """The value of a call, made in the context of the other side, and what it noted of skips and checkpoints."""
        for number in release:
            self._held.pop(number, None)
        with ExitStack() as around:
            around.enter_context(on_device(context["device"]))
            around.enter_context(skipping(Skips(**context["skips"])))
            tally = around.enter_context(tallied())
            kept = None
            if context["checkpoints"] is not None:
                kept = around.enter_context(checkpoints_in(Path(context["checkpoints"])))
            value = getattr(self, f"_{call}")(**arguments)
        noted = [[what, saved.total, saved.skipped] for what, saved in tally.lines().items()]
        return {"value": value, "noted": noted, "earlier_s": kept.earlier_s if kept else 0.0}

    def _create(self, target: str, settings: dict[str, str]) -> dict[str, Any]:
        module, _, attribute = target.partition(":")
        self._method = getattr(importlib.import_module(module), attribute)(**settings)
        ran_by = {"python": platform.python_version(), "packages": _loaded(), "source": source_digest(target)}
        return {"info": self._method.info.said, "config": self._method.config, "ran_by": ran_by}

    def _train(self, frames: list[Frame], seed: int) -> int:
        return self._hold(self._method.train(self._recording(frames), seed, self._progress))

    def _load(self, folder: str) -> int:
        return self._hold(self._method.load(Path(folder)))

    def _save(self, prior: int, folder: str) -> None:
        self._prior(prior).save(Path(folder))

    def _personalise(self, prior: int, frames: list[Frame], seed: int) -> dict[str, Any]:
        avatar = self._prior(prior).personalise(self._recording(frames), seed, self._progress)
        return {"avatar": self._hold(avatar), "recorded": isinstance(avatar, RecordedAvatar)}

    def _pose(self, avatar: int, viewpoint: Viewpoint) -> int:
        held: Avatar = self._held[avatar]
        return self._hold(held.pose(viewpoint))

    def _relight(self, posed: int, light: Light) -> dict[str, Any]:
        held: PosedAvatar = self._held[posed]
        return self._told(held.relight(light))

    def _recorded(self, avatar: int, query: Query) -> dict[str, Any]:
        held: RecordedAvatar = self._held[avatar]
        return self._told(held.relight(query))

    def _told(self, answer: Prediction) -> dict[str, Any]:
        """The prediction without its maps, which stay here until they are asked for: number and shape of each."""
        given = {name: getattr(answer, name) for name in ("depth", "normal")}
        maps = {name: [self._hold(value), np.shape(value)] for name, value in given.items() if value is not None}
        return {"prediction": replace(answer, depth=None, normal=None), "maps": maps}

    def _map(self, number: int) -> Array:
        return np.asarray(self._held[number])

    def _prior(self, number: int) -> Prior:
        return self._held[number]

    def _hold(self, value: Any) -> int:
        number = next(self._numbers)
        self._held[number] = value
        return number

    def _recording(self, frames: list[Frame]) -> Recording:
        return Recording(frames, self._observe)

    def _observe(self, frame: Frame) -> Observation:
        """The images of a frame, which the other side has. Raises what reading them raised there."""
        self._channel.send({"observe": frame.key})
        told = self._channel.receive()
        if "error" in told:
            raise revive(told["error"])
        return told["done"]

    def _progress(self, step: int, total: int, **values: float) -> None:
        self._channel.send({"progress": [step, total, {name: float(value) for name, value in values.items()}]})


def _loaded() -> dict[str, str]:
    """Versions of the packages that making the method has loaded."""
    tops = {name: vars(module).get("__version__") for name, module in sys.modules.items() if "." not in name}
    foreign = {name: version for name, version in tops.items() if name not in sys.stdlib_module_names}
    return {name: version for name, version in sorted(foreign.items()) if isinstance(version, str)}
