"""Which device methods work on: the CPU, unless the command line or a caller says otherwise.

A method that asks for it has its networks, its maps and their shading there; rays are traced and metrics measured on
the CPU, where all other methods work. The device is no part of a configuration: it decides how fast a result comes,
and is told in its provenance.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

from .errors import InputError

if TYPE_CHECKING:
    import torch

_name: ContextVar[str] = ContextVar("device", default="cpu")


@contextmanager
def on_device(name: str) -> Iterator[None]:
    """Run networks inside the block on "cpu", "cuda", "cuda:1", …; `InputError` for a device this machine lacks."""
    _check(name)
    before = _name.set(name)
    try:
        yield
    finally:
        _name.reset(before)


def device_name() -> str:
    """The name of the device that networks run on here."""
    return _name.get()


def device() -> torch.device:
    """The device of networks that are made here."""
    import torch

    return torch.device(_name.get())


def _check(name: str) -> None:
    if name == "cpu":
        return
    import torch

    try:
        torch.ones(1, device=torch.device(name)).sum().item()  # "meta" makes tensors, but computes nothing
    except Exception as error:  # torch has many, of its own and of drivers
        why = (str(error).strip() or type(error).__name__).splitlines()[0].split(". ")[0]  # torch goes on for a page
        raise InputError(
            f"device {name!r} cannot be used here ({why}); choose cpu, or cuda where it is set up"
        ) from error
