from __future__ import annotations

import pytest

from handbench.cli import main
from handbench.device import device, device_name, on_device
from handbench.errors import InputError


def test_networks_run_on_the_cpu_unless_told() -> None:
    assert device_name() == "cpu" and device().type == "cpu"
    with on_device("cpu"):
        assert device().type == "cpu"


@pytest.mark.parametrize("name", ["cuda:99", "no-such-device"])
def test_a_device_that_is_not_there_is_said(name: str) -> None:
    with pytest.raises(InputError, match=f"device '{name}' cannot be used here"), on_device(name):
        pass
    assert device_name() == "cpu"


def test_the_reason_is_one_sentence() -> None:
    """torch names all its backends where one is not built in."""
    with pytest.raises(InputError) as told, on_device("mps"):
        pass
    assert len(str(told.value)) < 250


def test_the_command_line_says_so_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "smoke", "--device", "cuda:99"]) == 2
    assert "choose cpu" in capsys.readouterr().err
