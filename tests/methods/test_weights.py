"""Weights on disk: the same weights are the same bytes, whatever process writes them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

WRITE = """
import sys, torch
from pathlib import Path
from threading import Thread
from handbench.methods.kit.weights import load_state, save_state

state = {"b": torch.arange(3.0), "a": torch.ones(2, 2)}
for folder in map(Path, sys.argv[1:]):
    folder.mkdir()
    thread = Thread(target=save_state, args=(folder, "m", {"steps": 3, "rate": [1e-3, 1e-4]}, state))
    thread.start()
    thread.join()
    found = load_state(folder, "m", {"rate": [1e-3, 1e-4], "steps": 3})
    assert all(torch.equal(found[name], value) for name, value in state.items())
"""


def test_equal_weights_are_equal_bytes_in_every_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The library orders what it writes by chance, which it draws anew for every thread; Python for every process."""
    folders = [tmp_path / name for name in ("one", "two", "three", "four", "five", "six")]
    here, there = [list(map(str, some)) for some in (folders[:3], folders[3:])]
    monkeypatch.setattr(sys, "argv", ["-c", *here])
    exec(compile(WRITE, "write", "exec"), {})
    environment = {**os.environ, "PYTHONHASHSEED": "1"}
    subprocess.run([sys.executable, "-c", WRITE, *there], check=True, env=environment)
    assert len({(folder / "weights.safetensors").read_bytes() for folder in folders}) == 1
