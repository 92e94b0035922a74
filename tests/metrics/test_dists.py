"""DISTS against published values, an independent float64 computation, and its weights."""

from __future__ import annotations

import importlib
from importlib.resources import files

import numpy as np
import pytest
import torch
from safetensors import safe_open

from handbench.metrics import Pair, metric

dists = importlib.import_module("handbench.metrics.dists")
networks = importlib.import_module("handbench.metrics.networks")


def linear(display: np.ndarray) -> np.ndarray:
    """The linear values that the sRGB curve shows as these."""
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def whole(prediction: np.ndarray, truth: np.ndarray) -> Pair:
    return Pair(prediction, truth, np.ones(truth.shape[:2]))


def test_published_values() -> None:
    """The example in torchmetrics' documentation, which runs with torch's seed 42; four decimals, the first of five."""
    random = torch.Generator().manual_seed(42)
    predictions, truths = (torch.rand(5, 3, 256, 256, generator=random).double() for _ in range(2))
    pair = whole(*(linear(x[0].permute(1, 2, 0).numpy()) for x in (predictions, truths)))
    assert metric("dists:region=full")([pair])[0].value == pytest.approx(0.1285, abs=5.5e-5)


def test_pooling_and_similarities_are_the_papers() -> None:
    """Written out in float64 numpy: L2 pooling by a 3 x 3 Hanning window every second pixel, Eq. 3 and 4."""
    rng = np.random.default_rng(0)
    x = rng.random((1, 2, 7, 9))
    window = np.outer([1, 2, 1], [1, 2, 1]) / 16
    padded = np.pad(x[0] ** 2, ((0, 0), (1, 1), (1, 1)))
    expected = [
        [[np.sqrt((window * padded[c, i : i + 3, j : j + 3]).sum()) for j in (0, 2, 4, 6, 8)] for i in (0, 2, 4, 6)]
        for c in range(2)
    ]
    pooled = dists._l2_pool(torch.from_numpy(x).float(), 2, 2)[0].numpy()
    assert pooled == pytest.approx(np.array(expected), abs=1e-6)

    a, b = rng.random((2, 50, 3))
    texture, structure = dists._similarities(*dists._moments(torch.from_numpy(a), torch.from_numpy(b)))
    means, variances = (a.mean(0), b.mean(0)), (a.var(0), b.var(0))
    covariance = (a * b).mean(0) - means[0] * means[1]
    assert texture.numpy() == pytest.approx((2 * means[0] * means[1] + 1e-6) / (means[0] ** 2 + means[1] ** 2 + 1e-6))
    assert structure.numpy() == pytest.approx((2 * covariance + 1e-6) / (sum(variances) + 1e-6))


def test_the_weights_are_whole_and_say_where_they_are_from() -> None:
    folder = files("handbench.metrics") / "weights"
    with safe_open(str(folder / "dists.safetensors"), "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
        assert "dists-pytorch 0.1 (sha256 73e54ce1" in file.metadata()["provenance"]
    assert {name: (t.shape, t.dtype) for name, t in tensors.items()} == dict.fromkeys(
        ("alpha", "beta"), (torch.Size([1475]), torch.float32)
    )
    alpha, beta = dists._weights()
    assert float(alpha.sum() + beta.sum()) == pytest.approx(1.0, abs=1e-6)
    assert "Keyan Ding" in (folder / "NOTICE").read_text()
