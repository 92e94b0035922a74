"""The checks for a GPU can be started anywhere."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest
import torch


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU: run tests/gpu/checks.py itself")
def test_without_a_gpu_they_say_so(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(Path(__file__).parent / "checks.py"), run_name="__main__")
    assert (end.value.code, capsys.readouterr().out.strip()) == (0, "no GPU")


def test_they_measure_what_they_say_on_any_device() -> None:
    checks = runpy.run_path(str(Path(__file__).parent / "checks.py"))
    told = checks["measured"]("cpu", textures=(64,), steps=1)
    assert told[checks["DIFFERENCE"]] == 0.0
    assert told["short trainings, seconds"].keys() == {"urhand", "relightablehands", "geometry"}
    assert told["training steps a second"]["64"] > 0.0
