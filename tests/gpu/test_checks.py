"""The checks for a GPU can be started anywhere."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import torch


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU: run tests/gpu/checks.py itself")
def test_without_a_gpu_they_say_so() -> None:
    done = subprocess.run(
        [sys.executable, str(Path(__file__).parent / "checks.py")], capture_output=True, text=True, timeout=300
    )
    assert (done.returncode, done.stdout.strip()) == (0, "no GPU"), done.stderr
