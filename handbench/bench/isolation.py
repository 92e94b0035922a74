"""What belongs to the whole process is put back after a method has run in it, so that no method disturbs the next."""

from __future__ import annotations

import gc
import os
import random
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from ..tuning import matrix_libraries

_Restore: TypeAlias = Callable[[], None]


@contextmanager
def isolated(loading: bool = False) -> Iterator[None]:
    """Put back, when the block ends, what code inside it changed of the process.

    That is the working directory, environment variables, `sys.path`, standard streams, warning filters, signal
    handlers, random states, numpy's treatment of floating-point errors, the threads of its matrix products, and
    torch's and jax's global settings. What a block did to other modules (a patched function) stays.

    loading     the block loads a plug-in, which may need the variables and the `sys.path` that it sets: they stay
    """
    with ExitStack() as stack:
        for saved in (_directory, _python, _signals, _random, _numpy, _products, _torch, _jax):
            stack.callback(saved())
        if not loading:
            stack.callback(_environment())
        stack.enter_context(warnings.catch_warnings())
        yield


def _directory() -> _Restore:
    before: Path | None = None
    with suppress(OSError):  # it may be gone
        before = Path.cwd()

    def restore() -> None:
        if before is not None:
            with suppress(OSError):
                os.chdir(before)

    return restore


def _environment() -> _Restore:
    before, path = dict(os.environ), list(sys.path)

    def restore() -> None:
        for name in os.environ.keys() - before.keys():
            del os.environ[name]
        os.environ.update({name: value for name, value in before.items() if os.environ.get(name) != value})
        sys.path[:] = path

    return restore


def _python() -> _Restore:
    streams = sys.stdin, sys.stdout, sys.stderr, sys.excepthook
    limit, collects, mask = sys.getrecursionlimit(), gc.isenabled(), os.umask(0)
    os.umask(mask)

    def restore() -> None:
        sys.stdin, sys.stdout, sys.stderr, sys.excepthook = streams
        sys.setrecursionlimit(limit)
        (gc.enable if collects else gc.disable)()
        os.umask(mask)

    return restore


def _signals() -> _Restore:
    """An interrupt must stay one. Handlers can be set in the main thread only, so only there they may have changed."""
    if threading.current_thread() is not threading.main_thread():
        return lambda: None
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for number, handler in before.items():
            if handler is not None and signal.getsignal(number) is not handler:
                signal.signal(number, handler)

    return restore


def _random() -> _Restore:
    python, legacy = random.getstate(), np.random.get_state()  # noqa: NPY002 - what methods may use

    def restore() -> None:
        random.setstate(python)
        np.random.set_state(legacy)  # noqa: NPY002

    return restore


def _numpy() -> _Restore:
    errors, call, printing = np.geterr(), np.geterrcall(), np.get_printoptions()

    def restore() -> None:
        np.seterr(**errors)
        np.seterrcall(call)
        np.set_printoptions(**printing)

    return restore


def _products() -> _Restore:
    """How many threads multiply matrices. Only where `tune` has said it: to find the libraries takes a while."""
    libraries = matrix_libraries() if matrix_libraries.cache_info().currsize else ()
    before = [library.get_num_threads() for library in libraries]

    def restore() -> None:
        for library, threads in zip(libraries, before, strict=True):
            if library.get_num_threads() != threads:
                library.set_num_threads(threads)

    return restore


def _torch() -> _Restore:
    """A block that loads torch itself must leave it as it comes."""
    torch = sys.modules.get("torch")
    before = [get() for get, *_ in _settings(torch)] if torch else None
    state = torch.get_rng_state() if torch else None
    on_gpus = torch.cuda.get_rng_state_all() if torch and torch.cuda.is_initialized() else None

    def restore() -> None:
        if (torch := sys.modules.get("torch")) is None:
            return
        settings = _settings(torch)
        for (get, put, fresh), value in zip(settings, before or [None] * len(settings), strict=True):
            wanted = fresh if before is None else value
            if wanted is not None and get() != wanted:
                put(wanted)
        if state is not None:
            torch.set_rng_state(state)
        if on_gpus is not None:
            torch.cuda.set_rng_state_all(on_gpus)

    return restore


def _settings(torch: Any) -> list[tuple[Callable[[], Any], Callable[[Any], None], Any]]:
    """torch's global settings: how to read one and to set it, and what it is at first (None: that depends)."""

    def set_device(device: Any) -> None:
        torch.set_default_device(None if device.type == "cpu" else device)

    def flag(name: str, fresh: bool) -> tuple[Callable[[], Any], Callable[[Any], None], Any]:
        owner = torch.backends.cudnn
        return lambda: getattr(owner, name), lambda value: setattr(owner, name, value), fresh

    return [
        (torch.is_grad_enabled, torch.set_grad_enabled, True),
        (torch.get_default_dtype, torch.set_default_dtype, torch.float32),
        (torch.get_default_device, set_device, torch.device("cpu")),
        (torch.get_num_threads, torch.set_num_threads, None),
        (torch.get_float32_matmul_precision, torch.set_float32_matmul_precision, "highest"),
        (torch.is_anomaly_enabled, torch.autograd.set_detect_anomaly, False),
        (torch.get_deterministic_debug_mode, torch.set_deterministic_debug_mode, 0),
        *(flag("enabled", True), flag("benchmark", False), flag("deterministic", False), flag("allow_tf32", True)),
    ]


def _jax() -> _Restore:
    """jax is loaded for some methods only; one that loads it finds and leaves it as it comes."""
    before = _double(sys.modules.get("jax"))

    def restore() -> None:
        jax = sys.modules.get("jax")
        if jax is not None and _double(jax) != before:
            jax.config.update("jax_enable_x64", before)

    return restore


def _double(jax: Any) -> bool:
    """Whether jax computes in float64 where nothing else is said; it does not unless the environment says so."""
    if jax is None:
        return os.environ.get("JAX_ENABLE_X64", "").lower() in ("1", "true", "t", "on", "yes", "y")
    return bool(jax.config.jax_enable_x64)
