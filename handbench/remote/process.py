"""The worker process: started in another interpreter, asked one thing at a time, killed when it does not answer."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import signal
import socket
import subprocess
import tempfile
import time
import weakref
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..checkpoint import checkpoints
from ..device import device_name
from ..errors import HandbenchError, InputError
from ..skips import note, skips
from .faults import describe, revive
from .wire import Channel, Closed, Garbled

_BOOT = Path(__file__).with_name("boot.py")
_PACKAGES = ("handbench", "handbench.methods", "handbench.metrics", "handbench.protocols", "handbench.reports")
_OURS = ("PYTHONPATH", "PYTHONHOME", "PYTHONSTARTUP")  # what would lead the other interpreter to our packages
_SIGNALS = {each.value: each.name for each in signal.Signals}
_LAST_WORDS = 300


class WorkerFailed(HandbenchError):
    """The worker process died, hung or spoke nonsense; it is gone."""


@dataclass(frozen=True)
class Limits:
    """Seconds that a call may take before the worker is killed."""

    start: float = 300.0
    train: float = 86400.0
    personalise: float = 21600.0
    relight: float = 600.0
    files: float = 600.0

    def of(self, call: str) -> float:
        limits = {"create": self.start, "load": self.files, "save": self.files, **asdict(self)}
        limits |= {"pose": self.relight, "recorded": self.relight, "map": self.relight}
        return limits[call]


class Worker:
    """A process of the interpreter `python`, in a session of its own, so that its children die with it.

    It talks over a socket of its own: what it prints harms nothing and is kept for the reason of a failure.
    """

    def __init__(self, python: str, path: tuple[str, ...], limits: Limits) -> None:
        """Start it. Raises `InputError` if there is no such interpreter."""
        self._limits, self._pid = limits, os.getpid()
        self._release: list[int] = []
        self.failure = ""  # why it is gone, if it failed
        self._deadline: tuple[str, float, float] = ("start", limits.start, time.monotonic() + limits.start)
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the worker
        here, there = socket.socketpair()
        told = {"handbench": _places(), "path": path, "socket": there.fileno()}
        command = [python, "-u", str(_BOOT), json.dumps(told)]
        environment = {name: value for name, value in os.environ.items() if name not in _OURS}
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,  # never written to: its end tells the worker that we are gone
                stdout=self._said,
                stderr=self._said,
                pass_fds=(there.fileno(),),
                env=environment,
                start_new_session=True,
            )
        except OSError as error:
            here.close()
            self._said.close()
            raise InputError(f"interpreter {python} cannot be started ({error.strerror}); check its path") from error
        finally:
            there.close()
        self._channel = Channel(here, self._watch, self._check_time)  # also of one that keeps talking
        self._end = weakref.finalize(self, _end, self._process, here, self._said, os.getpid())

    @property
    def alive(self) -> bool:
        if self._end.alive and self._pid == os.getpid() and self._process.poll() is not None:
            self.failure = self._failure("a pause between calls", Closed("the process has ended"))
            self.end()  # what it started may live on
        return self._end.alive and self._pid == os.getpid()

    def call(self, name: str, replies: Mapping[str, Callable[[Any], Any]] | None = None, **arguments: Any) -> Any:
        """The answer to a call, made with our device, skips and checkpoints.

        `replies` maps what the worker may send meanwhile to functions; what they return, unless None, is sent back.
        Raises what the call raised over there, and `WorkerFailed` if there is no answer; then the worker is gone.
        """
        kept = checkpoints()
        context = {
            "device": device_name(),
            "skips": asdict(skips()),
            "checkpoints": str(kept.folder.absolute()) if kept else None,
        }
        limit = self._limits.of(name)
        self._deadline = (name, limit, time.monotonic() + limit)
        release, self._release = self._release, []
        try:
            self._channel.send({"call": name, "arguments": arguments, "context": context, "release": release})
            answer = self._answer(replies or {})
        except (Closed, Garbled) as error:
            self.failure = self._failure(name, error)
            self.end()
            raise WorkerFailed(self.failure) from error
        except BaseException as error:  # the conversation is cut in the middle
            self.failure = str(error) if isinstance(error, WorkerFailed) else ""
            self.end()
            raise
        if "error" in answer:
            raise revive(answer["error"])
        done = answer["done"]
        for what, total, skipped in done["noted"]:
            note(what, total, skipped)
        if kept:
            kept.earlier_s = done["earlier_s"]
        return done["value"]

    def release(self, number: int) -> None:
        """Let the worker forget what it holds under a number, when next it is called."""
        self._release.append(number)

    def end(self) -> None:
        """Kill the worker and all it has started."""
        self._end()

    def _answer(self, replies: Mapping[str, Callable[[Any], Any]]) -> dict[str, Any]:
        while True:
            message = self._channel.receive()
            if not isinstance(message, dict) or len(message) != 1:
                raise Garbled("a message that is none of ours")
            ((kind, content),) = message.items()
            if kind in ("done", "error"):
                return message
            if kind not in replies:
                raise Garbled(f"the unknown message {str(kind)[:40]!r}")
            try:
                reply = replies[kind](content)
            except Exception as error:
                self._channel.send({"error": describe(error)})
            else:
                if reply is not None:
                    self._channel.send({"done": reply})

    def _watch(self) -> None:
        """Called while nothing comes."""
        self._check_time()
        if self._process.poll() is not None:
            raise Closed("the process has ended")

    def _check_time(self) -> None:
        name, limit, until = self._deadline
        if time.monotonic() > until:
            raise WorkerFailed(f"no answer to {name} within {limit:g} s; the process was killed")

    def _failure(self, name: str, error: Closed | Garbled) -> str:
        """Why there is no answer."""
        if isinstance(error, Garbled):
            return f"the process sent {error} during {name} and was killed{self._last_words()}"
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(5)
        code = self._process.poll()
        if code is not None and code < 0:
            how = f"was ended by {_SIGNALS.get(-code, f'signal {-code}')}"
            how += ", as systems do where memory runs short," if -code == signal.SIGKILL else ""
        else:
            how = "closed its connection" if code is None else f"ended with exit code {code}"
        return f"the process {how} during {name}{self._last_words()}"

    def _last_words(self) -> str:
        """The last line that the worker printed, for a reason."""
        size = self._said.seek(0, os.SEEK_END)
        self._said.seek(max(0, size - 4096))
        lines = self._said.read().decode(errors="replace").split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "")
        return f"; it said: {last[:_LAST_WORDS]}" if last else ""


def _end(process: subprocess.Popen[Any], connection: socket.socket, said: Any, owner: int) -> None:
    if os.getpid() != owner:  # a fork of the process that started it
        return
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    connection.close()
    said.close()
    if process.stdin is not None:
        process.stdin.close()


def _places() -> list[str]:
    """The folders in which submodules of handbench are found: one, or two in a checkout."""
    places = []
    for name in _PACKAGES:
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.submodule_search_locations:
            folder = Path(next(iter(spec.submodule_search_locations))).resolve()
            places.append(str(folder if name == "handbench" else folder.parent))
    return list(dict.fromkeys(places))
