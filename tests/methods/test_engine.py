"""The training engine: repeatable, resumable bit for bit, stopped by what is not finite."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from handbench.checkpoint import checkpoints_in
from handbench.errors import InputError, NonFinite
from handbench.methods.kit import checkpoint
from handbench.methods.kit.engine import Budget, Player, fit, light_weights
from handbench.methods.kit.layers import Keep, channels_last

BUDGET = Budget(steps=60, batch=2, rate=(1e-2, 1e-3), warmup=5)
BRIEF = Budget(steps=9, batch=2, rate=(1e-2, 1e-3), warmup=2)


class Killed(Exception):
    pass


class Game:
    """A convolution that learns a target picture, and a critic that learns to tell both apart."""

    def __init__(self, die_at: int = -1) -> None:
        torch.manual_seed(0)
        self.painter, self.critic = Keep(3, 3), nn.Conv2d(3, 1, 3)
        for module in (self.painter, self.critic):
            channels_last(module)
        self.inputs = torch.rand(5, 1, 3, 8, 8)
        self.die_at, self.calls = die_at, 0
        self.seen: list[int] = []

    def paint(self, sample: int, rng: np.random.Generator) -> Mapping[str, Tensor]:
        self.calls += 1
        if self.calls == self.die_at:
            raise Killed
        self.seen.append(sample)
        noise = torch.from_numpy(rng.normal(size=(1, 3, 8, 8))).float()
        self.painted = self.painter(self.inputs[sample] + 0.1 * noise)
        return {
            "l1": (self.painted - self.inputs[sample].flip(1)).abs().mean(),
            "adversarial": -0.01 * self.critic(self.painted).mean(),
        }

    def judge(self, sample: int, rng: np.random.Generator) -> Mapping[str, Tensor]:
        real, fake = self.critic(self.inputs[sample]), self.critic(self.painted.detach())
        return {"hinge": (1 - real).relu().mean() + (1 + fake).relu().mean()}

    def play(self, budget: Budget = BUDGET, seed: int = 0) -> list[tuple[int, dict[str, float]]]:
        told: list[tuple[int, dict[str, float]]] = []
        players = [Player("painter", self.painter, self.paint), Player("critic", self.critic, self.judge)]
        fit("game", players, len(self.inputs), budget, seed, lambda step, total, **values: told.append((step, values)))
        return told

    @property
    def weights(self) -> list[Tensor]:
        return [p.detach().clone() for module in (self.painter, self.critic) for p in module.parameters()]


def test_the_loss_falls_and_every_sample_comes_before_any_comes_again() -> None:
    game = Game()
    told = game.play()
    assert [step for step, _ in told] == [20, 40, 60]
    assert told[-1][1]["l1"] < 0.9 * told[0][1]["l1"]
    assert set(told[0][1]) == {"loss", "l1", "adversarial", "critic hinge"}
    assert len(game.seen) == 120
    assert all(sorted(game.seen[i : i + 5]) == list(range(5)) for i in range(0, 120, 5))


def test_a_player_moves_its_own_weights_only() -> None:
    game = Game()
    before = game.weights
    game.judge = lambda sample, rng: {"hinge": 0.0 * game.critic(game.painted.detach()).sum()}  # type: ignore[method-assign]
    game.play(Budget(3, 1, (1e-2, 1e-3)))
    changed = [not torch.equal(a, b) for a, b in zip(before, game.weights, strict=True)]
    assert changed == [True, True, False, False]  # the adversarial term moves the painter, never the critic


def test_a_killed_training_ends_as_one_that_was_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Game()
    told = whole.play()
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    for die_at in (2, 15, 77):
        killed = Game(die_at)
        with checkpoints_in(tmp_path / str(die_at)):
            with pytest.raises(Killed):
                killed.play()
            resumed = Game()
            again = resumed.play()
        assert all(torch.equal(a, b) for a, b in zip(whole.weights, resumed.weights, strict=True)), die_at
        assert again == told
        assert die_at < 3 or resumed.calls < whole.calls  # it went on, it did not start anew


def test_a_stage_that_leaves_weights_untouched_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def play(die_at: int = -1) -> tuple[list[Tensor], int]:
        torch.manual_seed(0)
        both = nn.ModuleList([nn.Linear(2, 2), nn.Linear(2, 1)])  # this stage draws with the first alone
        calls = 0

        def losses(sample: int, rng: np.random.Generator) -> Mapping[str, Tensor]:
            nonlocal calls
            calls += 1
            if calls == die_at:
                raise Killed
            return {"l2": both[0](torch.ones(2)).square().sum()}

        fit("stage", [Player("both", both, losses)], 5, BUDGET, 0, lambda step, total, **values: None)
        return [p.detach().clone() for p in both.parameters()], calls

    whole, every = play()
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    with checkpoints_in(tmp_path):
        with pytest.raises(Killed):
            play(77)
        resumed, rest = play()
    assert rest < every  # it went on, it did not start anew
    assert all(torch.equal(a, b) for a, b in zip(whole, resumed, strict=True))


def test_a_damaged_or_foreign_checkpoint_starts_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    whole = Game()
    with checkpoints_in(tmp_path):
        whole.play(BRIEF)
        file = tmp_path / "game.safetensors"
        kept = file.read_bytes()
        for content in (kept[: len(kept) // 2], b"", b"no tensors at all"):
            file.write_bytes(content)
            again = Game()
            again.play(BRIEF)
            assert again.calls == whole.calls
            assert all(torch.equal(a, b) for a, b in zip(whole.weights, again.weights, strict=True))
    assert [path.name for path in tmp_path.iterdir()] == ["game.safetensors"]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Game, Path]:
    """A brief training, and the folder of its checkpoint."""
    game, folder = Game(), tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch, checkpoints_in(folder):
        patch.setattr(checkpoint, "EVERY", 0.0)
        game.play(BRIEF)
    return game, folder


@pytest.mark.parametrize(
    "wrong",
    [
        {"step": None},
        {"step": "10"},
        {"step": 10**9},
        {"step": 0},
        {"step": True},
        {"means": 3},
        {"means": {"l1": None}},
        {"means": {"l1": float("nan")}},
        {"told": [[1]]},
        {"seconds": []},
        {"weights": float("nan")},
        {"digest": "0" * 32},
        {"about": "[]"},
    ],
    ids=str,
)
def test_a_checkpoint_that_cannot_be_starts_anew_with_a_word(
    finished: tuple[Game, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
    wrong: dict[str, Any],
) -> None:
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    whole, folder = finished
    with checkpoints_in(tmp_path):
        file = shutil.copy(folder / "game.safetensors", tmp_path)
        with safe_open(file, framework="pt") as opened:
            about = json.loads(opened.metadata()["about"])
        tensors = load_file(file)
        if "weights" in wrong:
            next(iter(tensors.values())).view(-1)[0] = wrong["weights"]
        changed = {name: value for name, value in {**about, **wrong}.items() if value is not None}
        told = wrong.get("about", json.dumps(changed))
        digest = wrong.get("digest", checkpoint._digest(told, tensors))
        save_file(tensors, file, {"about": told, "digest": digest})
        again = Game()
        again.play(BRIEF)
    assert again.calls == whole.calls
    assert all(torch.equal(a, b) for a, b in zip(whole.weights, again.weights, strict=True))
    assert "game.safetensors cannot be used (" in capsys.readouterr().err


def test_the_rate_rises_then_falls_to_its_last_value() -> None:
    budget = Budget(steps=101, batch=1, rate=(1e-3, 1e-5), warmup=10)
    rates = [budget.rate_at(step) for step in range(101)]
    assert rates[0] == pytest.approx(1e-4)
    assert max(rates) == rates[9] and rates == [*sorted(rates[:10]), *sorted(rates[10:], reverse=True)]
    assert rates[-1] == pytest.approx(1e-5)


@pytest.mark.parametrize("wrong", [{"steps": 0}, {"batch": 0}, {"rate": (1e-5, 1e-3)}, {"rate": (0.0, 0.0)}])
def test_a_budget_that_cannot_be_is_said(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError, match=next(iter(wrong))):
        Budget(**{"steps": 1, "batch": 1, "rate": (1e-3, 1e-4), **wrong})  # type: ignore[arg-type]


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_nothing_is_trained_through_what_is_not_finite(bad: float) -> None:
    game = Game()
    game.inputs[3] = bad
    before = game.weights
    with pytest.raises(NonFinite, match=r"game: step \d gave l1 (nan|inf).* lower the rate"):
        game.play(Budget(5, 5, (1e-3, 1e-3)))
    assert all(torch.equal(a, b) for a, b in zip(before, game.weights, strict=True))


def test_light_weights_are_nonnegative_and_few() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        weights = light_weights(6, (1, 2, 3, 5), rng)
        assert weights.shape == (6,) and (weights >= 0).all()
        assert 1 <= np.count_nonzero(weights) <= 5
