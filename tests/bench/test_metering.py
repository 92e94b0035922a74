"""What a piece of work takes: memory that was held, sizes of what is kept, counters that begin anew."""

from __future__ import annotations

import mmap
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file

from handbench.bench import metering
from handbench.bench.metering import held_bytes, kept_size, metered, parameters

linux = pytest.mark.skipif(sys.platform != "linux", reason="only Linux lets a process's peak memory begin anew")


@linux
def test_the_peak_is_of_the_block_and_not_of_what_was_before() -> None:
    np.ones(40 << 20, np.uint8).sum()  # 40 MiB, gone again
    with metered() as little:
        pass
    with metered() as much, mmap.mmap(-1, 100 << 20) as held:  # new to the process, unlike memory freed and kept
        for _ in range(100):
            held.write(bytes(1 << 20))
    with metered() as after:
        pass
    assert little.peak_mb is not None and much.peak_mb is not None and after.peak_mb is not None
    assert 90 <= much.peak_mb - little.peak_mb <= 115
    assert after.peak_mb < much.peak_mb - 80, "what was given back does not count for the next block"


def test_a_block_that_fails_is_measured_all_the_same() -> None:
    with pytest.raises(RuntimeError), metered() as meter:
        raise RuntimeError
    assert (meter.peak_mb is not None) == (sys.platform == "linux")


def test_energy_is_told_where_the_machine_tells_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metering, "_RAPL", tmp_path)
    with metered() as nothing:
        pass
    assert nothing.energy_j is None
    package = tmp_path / "intel-rapl:0"
    package.mkdir()
    (package / "max_energy_range_uj").write_text("1000000\n")
    (package / "energy_uj").write_text("900000\n")
    with metered() as meter:
        (package / "energy_uj").write_text("150000\n")  # it began anew
    assert meter.energy_j == 0.25


def test_parameters_are_counted_from_the_files_and_bytes_of_all_of_them(tmp_path: Path) -> None:
    assert parameters(tmp_path) is None and kept_size(tmp_path) == 0
    save_file({"a": np.zeros((3, 5), np.float32), "b": np.zeros(7, np.float16)}, tmp_path / "net.safetensors")
    save_file({"c": np.zeros((), np.float32)}, tmp_path / "one.safetensors", metadata={"told": "it"})
    (tmp_path / "more.json").write_text("{}")
    assert parameters(tmp_path) == 15 + 7 + 1
    assert kept_size(tmp_path) == sum(path.stat().st_size for path in tmp_path.iterdir())


def test_arrays_are_counted_once_wherever_they_are() -> None:
    torch = pytest.importorskip("torch")

    @dataclass(slots=True)
    class Slotted:
        image: Any

    class Held:
        def __init__(self) -> None:
            self.texture = np.zeros((10, 10), np.float32)
            self.view = self.texture[2:4]
            self.deep = {"list": [Slotted(np.zeros(25, np.float64)), (self.texture,)], "self": self}
            self.net = torch.nn.Linear(4, 5)
            self.words = "no array"

    assert held_bytes(Held()) == 400 + 200 + 4 * (20 + 5)
    assert held_bytes(None) == 0


def test_the_hand_model_that_avatars_share_is_not_counted() -> None:
    from handbench.hand import hand_model

    hand = hand_model()
    hand.topology(1)
    assert held_bytes(vars(hand)) > 1 << 20
    assert held_bytes({"hand": hand, "texture": np.zeros(5)}) == 40


def test_sparse_tensors_count_their_indices_and_values() -> None:
    torch = pytest.importorskip("torch")
    sparse = torch.sparse_coo_tensor(torch.tensor([[0, 1, 1], [2, 0, 2]]), torch.ones(3), (2, 3))
    assert held_bytes({"matrix": sparse}) == 3 * (2 * 8 + 4)
