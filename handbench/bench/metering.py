"""What a piece of work takes of the machine beside time: memory, energy, and the size of what is kept."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..contents import arrays_in

_PROC = Path("/proc")
_RAPL = Path("/sys/class/powercap")
_HEADER = 1 << 24  # bytes of a safetensors header


@dataclass
class Meter:
    """None where the machine does not tell.

    peak_mb    the greatest resident memory of this process and its children, in MiB
    vram_mb    the greatest memory that torch held on GPUs, in MiB
    energy_j   what the processor packages took, by their own counters (RAPL)
    """

    peak_mb: float | None = None
    vram_mb: float | None = None
    energy_j: float | None = None


@contextmanager
def metered() -> Iterator[Meter]:
    """Measure what the block takes; the meter is filled when the block ends, however it ends."""
    meter, family, before = Meter(), _family(), _energy()
    known = [_restart(process) for process in family]
    if (cuda := _cuda()) is not None:
        for device in range(cuda.device_count()):
            cuda.reset_peak_memory_stats(device)
    try:
        yield meter
    finally:
        if family and all(known):
            peaks = [peak for process in _family() if (peak := _peak_kb(process)) is not None]
            meter.peak_mb = round(sum(peaks) / 1024, 1) if peaks else None
        if (cuda := _cuda()) is not None:  # the block may be what loads torch
            held = sum(cuda.max_memory_allocated(device) for device in range(cuda.device_count()))
            meter.vram_mb = round(held / 2**20, 1)
        meter.energy_j = _joules(before, _energy())


def _cuda() -> Any:
    """torch.cuda where torch is loaded and finds a GPU."""
    torch = sys.modules.get("torch")
    return torch.cuda if torch is not None and torch.cuda.is_available() else None


def _family() -> list[int]:
    """This process and all below it: methods may draw in a process of their own."""
    found, left = [], [os.getpid()]
    while left:
        process = left.pop()
        found.append(process)
        try:
            for children in (_PROC / str(process) / "task").glob("*/children"):
                left += [int(child) for child in children.read_text().split()]
        except OSError:  # it has ended, or the system has no such files
            continue
    return found


def _restart(process: int) -> bool:
    """Let a process's greatest memory count from now; whether that could be done."""
    try:
        (_PROC / str(process) / "clear_refs").write_text("5")
    except OSError:
        return False
    return True


def _peak_kb(process: int) -> int | None:
    try:
        lines = (_PROC / str(process) / "status").read_text().splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) for line in lines if line.startswith("VmHWM:")), None)


def _energy() -> dict[str, tuple[int, int]]:
    """The counter of each processor package and where it begins anew, in microjoules; empty without leave to read."""
    found = {}
    for package in sorted(_RAPL.glob("intel-rapl:?")):
        try:
            counts = (package / "energy_uj").read_text(), (package / "max_energy_range_uj").read_text()
            found[package.name] = (int(counts[0]), int(counts[1]))
        except (OSError, ValueError):
            continue
    return found


def _joules(before: dict[str, tuple[int, int]], after: dict[str, tuple[int, int]]) -> float | None:
    if not before or before.keys() != after.keys():
        return None
    ranges = ((after[name][0] - count, whole) for name, (count, whole) in before.items())
    return round(sum(apart if apart >= 0 else apart + whole for apart, whole in ranges) / 1e6, 3)


def kept_size(folder: Path) -> int:
    """Bytes of all files of a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def parameters(folder: Path) -> int | None:
    """How many numbers the safetensors files of a trained state hold; None without any such file."""
    files = sorted(folder.rglob("*.safetensors"))
    return sum(map(_numbers, files)) if files else None


def _numbers(path: Path) -> int:
    """The product of each array's shape, summed: a safetensors file begins with its header's length and its header."""
    with path.open("rb") as file:
        length = int.from_bytes(file.read(8), "little")
        header = json.loads(file.read(min(length, _HEADER)))
    total = 0
    for name, about in header.items():
        if name != "__metadata__":
            count = 1
            for side in about["shape"]:
                count *= side
            total += count
    return total


def held_bytes(value: Any) -> int:
    """Bytes of all arrays and tensors that a value holds, each counted once, whatever it is made of.

    A hand model counts nothing: one object with its caches serves all avatars.
    """
    models = sys.modules.get("handbench.hand.handmodel")  # not loaded for this: it brings torch
    arrays: dict[int, int] = {}
    for each in arrays_in(value, apart=(models.HandModel,) if models else ()):
        where, size = _memory(each)
        arrays[where] = max(arrays.get(where, 0), size)
    return sum(arrays.values())


def _memory(array: Any) -> tuple[int, int]:
    """Where an array's memory is and how much there is of it; views share theirs."""
    if isinstance(array, np.ndarray):
        while isinstance(array.base, np.ndarray):
            array = array.base
        return id(array), int(array.nbytes)
    storage = getattr(array, "untyped_storage", None)
    if callable(storage):
        held = storage()
        return held.data_ptr(), int(held.nbytes())
    return id(array), int(array.nbytes)
