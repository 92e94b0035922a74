"""Training of PALM-Net's prior on the shipped scans: repeatable, resumable, stopped by what is not finite."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from handbench.checkpoint import checkpoints_in
from handbench.data.capture import Capture
from handbench.data.openstage import open_capture
from handbench.errors import InputError, NonFinite, Unsupported
from handbench.hand import hand_model
from handbench.method import Recording, silent
from handbench.methods.kit import checkpoint
from handbench.methods.kit.engine import Player, fit
from handbench.methods.palm.config import PRESETS, PalmConfig
from handbench.methods.palm.frames import Taken, drawn, taken
from handbench.methods.palm.model import PalmModel
from handbench.methods.palm.pixels import square
from handbench.methods.palm.registration import registered
from handbench.methods.palm.training import Lesson, trained
from handbench.scene import Observation, Pose

SHORT = replace(PRESETS["smoke"], geometry_steps=4, steps=4, light_from=0.0, warmup=0, spacing=1e-2)


@pytest.fixture(scope="module")
def scans() -> Capture:
    return open_capture("mini", capture="openscans")


@pytest.fixture(scope="module")
def recording(scans: Capture) -> Recording:
    return scans.recording(f for f in scans.frames() if f.subject == "s25")


@pytest.fixture(scope="module")
def poses(recording: Recording) -> list[Taken]:
    return taken(recording.where(lambda frame: frame.pose_name == "pose-0"), hand_model(), False, 0)


def _train(recording: Recording, config: PalmConfig = SHORT) -> tuple[PalmModel, list[tuple[int, dict[str, float]]]]:
    told: list[tuple[int, dict[str, float]]] = []
    model = trained(config, hand_model(), recording, 0, lambda step, total, **values: told.append((step, values)))
    return model, told


def test_the_prior_learns_the_scans_and_the_pictures(recording: Recording) -> None:
    alone = recording.where(lambda frame: frame.pose_name == "pose-0")
    model, told = _train(alone, replace(SHORT, geometry_steps=40, steps=6))
    assert [step for step, _ in told] == [20, 40, 46]
    assert told[1][1]["scan"] < 0.8 * told[0][1]["scan"]
    assert {"l1", "mask", "physical", "normal", "eikonal", "latent", "perceptual"} < set(told[2][1])
    assert int(model.drawn) == 6


def test_one_seed_gives_one_prior_killed_or_not(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, _ = _train(recording)
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    steps = []

    class Killed(Exception):
        pass

    pictures = Lesson.pictures

    def dying(self: Lesson, sample: int, rng: np.random.Generator):  # type: ignore[no-untyped-def]
        steps.append(sample)
        if len(steps) == 3:
            raise Killed
        return pictures(self, sample, rng)

    monkeypatch.setattr(Lesson, "pictures", dying)
    with checkpoints_in(tmp_path):
        with pytest.raises(Killed):
            _train(recording)
        resumed, _ = _train(recording)
    assert len(steps) == 3 + 2  # it went on
    for (name, a), b in zip(whole.state_dict().items(), resumed.state_dict().values(), strict=True):
        assert torch.equal(a, b), name


@pytest.mark.parametrize(
    ("field", "term"),
    [("geometry_field", "eikonal"), ("radiance_field", "l1"), ("material_field", "physical"), ("phi", "latent")],
)
def test_nan_in_a_field_stops_training_with_the_step_and_the_term(poses: list[Taken], field: str, term: str) -> None:
    torch.manual_seed(0)
    model = PalmModel(SHORT, hand_model(), 1)
    part = getattr(model, field)
    with torch.no_grad():
        (part if isinstance(part, nn.Parameter) else list(part.parameters())[-1]).fill_(torch.nan)
    player = Player("prior", model, Lesson(model, poses).pictures)
    with pytest.raises(NonFinite, match=rf"palm: step 1 gave .*{term} nan"):
        fit("palm", [player], len(poses), SHORT.budget(2), 0, silent)


def test_registration_brings_the_hand_model_to_the_scans(scans: Capture) -> None:
    """From what a tracker says, within a millimetre of the true vertices, which it is never told."""
    hand = hand_model()
    frames = {f.pose_name: f for f in scans.frames() if f.subject == "s26"}
    told = [f.pose for f in frames.values()]
    assert all(isinstance(pose, Pose) for pose in told)
    shape = next(iter(frames.values())).shape
    found, poses = registered(hand, shape, told, [scans.observe(f).scan for f in frames.values()])  # type: ignore[arg-type,misc]
    for frame, pose in zip(frames.values(), poses, strict=True):
        true = hand.mesh(scans.truth(frame).shape, scans.truth(frame).pose, 0).vertices
        before = np.linalg.norm(hand.mesh(shape, frame.pose, 0).vertices - true, axis=1).mean()
        after = np.linalg.norm(hand.mesh(found, pose, 0).vertices - true, axis=1).mean()
        assert after < 0.8e-3 < before


def test_rays_show_the_pixels_that_they_go_through(recording: Recording, poses: list[Taken]) -> None:
    (pose,) = poses
    rays = drawn(pose, 200, 16, np.random.default_rng(0))
    assert len(rays.origins) == 200 + 256 and rays.normal is not None
    assert 0.5 < float((rays.alpha[:200] > 0.5).float().mean()) < 0.95
    seen = {f.camera.name: recording.observe(f) for f in recording.frames if f.pose_name == "pose-0"}
    cameras = {f.camera.name: f.camera for f in recording.frames}
    for k in range(0, 200, 20):
        name = min(cameras, key=lambda n: float(np.linalg.norm(cameras[n].centre - rays.origins[k].numpy())))
        place, _ = cameras[name].project(rays.origins[k].double().numpy() + 0.5 * rays.directions[k].double().numpy())
        column, row = np.floor(place).astype(int)
        assert np.allclose(seen[name].image[row, column], rays.image[k].numpy(), atol=1e-3)


def test_a_patch_is_about_the_hand_and_somewhere_where_the_mask_is_faint() -> None:
    hand = np.zeros((20, 30), dtype=bool)
    hand[3, 28] = True
    rows, columns = square(hand, 8, np.random.default_rng(0))
    assert hand[rows, columns].any() and len(rows) == 64 and columns.max() == 29
    rows, columns = square(np.zeros_like(hand), 8, np.random.default_rng(0))
    assert len(rows) == 64 and rows.max() < 20 and columns.max() < 30


def test_what_cannot_be_trained_on_is_refused(
    recording: Recording, poses: list[Taken], monkeypatch: pytest.MonkeyPatch
) -> None:
    hand = hand_model()
    with pytest.raises(Unsupported, match="no training frames"):
        taken(recording.where(lambda frame: False), hand, False, 0)
    with monkeypatch.context() as patch, pytest.raises(InputError, match="no skinning weights"):
        patch.setattr(type(hand), "weights", lambda self, level: np.zeros(0))
        trained(SHORT, hand, recording, 0, silent)
    with pytest.raises(Unsupported, match="smaller patch"):
        drawn(poses[0], 10, 64, np.random.default_rng(0))

    def empty(frame):  # type: ignore[no-untyped-def]
        seen = recording.observe(frame)
        return Observation(seen.image * 0, seen.alpha * 0, seen.normal, scan=seen.scan)

    with pytest.raises(Unsupported, match=r"mask of .* is empty"):
        taken(Recording(recording.frames, empty), hand, False, 0)
    joints = replace(recording.frames[0], pose=Pose(np.zeros((16, 3))))
    with pytest.raises(Unsupported, match="16"):
        taken(Recording([joints], recording.observe), hand, False, 0)
