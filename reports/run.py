"""What a report reads of a run folder: the plan of the last run and its finished cells."""

from __future__ import annotations

from handbench.results.origin import Hardware
from handbench.results.reading import Run, merged, read_plan, read_run

from .model import counted

__all__ = ["Run", "machine", "merged", "read_plan", "read_run"]


def machine(device: Hardware | None) -> str:
    """The device in one line: "AMD EPYC 7B13, 2 cores, 2 threads, 24 GB"."""
    if device is None:
        return "an unknown machine"
    counts = [counted(count, noun) for count, noun in ((device.cores, "core"), (device.threads, "thread")) if count]
    memory = [f"{device.memory_gb:.0f} GB"] if device.memory_gb else []
    return ", ".join([device.cpu, *counts, *memory, *device.gpus])
