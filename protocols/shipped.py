"""One attribute for each TOML file of this folder: the protocol it holds, read when asked for."""

from __future__ import annotations

from pathlib import Path

from handbench.bench.protocol import Protocol

from .loader import load


def __getattr__(name: str) -> Protocol:
    path = Path(__file__).with_name(f"{name}.toml")
    if name.startswith("_") or not path.is_file():
        raise AttributeError(f"there is no protocol file {path.name}")
    return load(path)
