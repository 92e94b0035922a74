"""A method on the autoencoder's meshes: which of them, made of what, and that nothing of the scored pictures leaks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from flat import flat_cells

from handbench.bench.resolving import Selected, resolve
from handbench.bench.run import find_protocol, run
from handbench.data.capture import Capture
from handbench.errors import InputError, NonFinite, Unsupported
from handbench.hand.openhand.model import OpenHand
from handbench.method import Avatar, Method, MethodInfo, PosedAvatar, Prior, Progress, Recording, silent
from handbench.methods.geometry.config import GeometryConfig
from handbench.methods.geometry.method import TrackedMethod, TrackedPrior
from handbench.methods.geometry.tracker import Tracker, Tracking
from handbench.registry import METHODS
from handbench.scene import Frame, Light, Observation, Pose, Prediction, Query, Viewpoint
from handbench.settings import Setting

SMALL = GeometryConfig(image=32, depth=32, points=400, steps=4, warmup=1, code=8)


class Spy(Method):
    """A method that remembers what it is shown."""

    info = MethodInfo("spy", "Spy", "remembers", universal=True, linear=True)

    @property
    def config(self) -> dict:
        return {}

    def __init__(self) -> None:
        self.trained: list[Frame] = []
        self.enrolled: list[Frame] = []
        self.asked: list[Query] = []

    def train(self, recording: Recording, seed: int = 0, progress: Progress = silent) -> Prior:
        self.trained += recording.frames
        progress(1, 1, loss=2.0)
        return SpyPrior(self)

    def load(self, folder: Path) -> Prior:
        return SpyPrior(self)


class SpyPrior(Prior):
    def __init__(self, spy: Spy) -> None:
        self.spy = spy

    def personalise(self, enrolment: Recording, seed: int = 0, progress: Progress = silent) -> Avatar:
        self.spy.enrolled += enrolment.frames
        return SpyAvatar(self.spy)

    def save(self, folder: Path) -> None:
        (folder / "nothing").touch()


class SpyAvatar(Avatar):
    def __init__(self, spy: Spy) -> None:
        self.spy = spy

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        self.spy.asked.append(viewpoint)
        return PosedSpy(viewpoint)


class PosedSpy(PosedAvatar):
    def __init__(self, viewpoint: Viewpoint) -> None:
        self.size = (viewpoint.camera.height, viewpoint.camera.width)

    def relight(self, light: Light) -> Prediction:
        return Prediction(np.zeros((*self.size, 3)), np.zeros(self.size))


@pytest.fixture(scope="module")
def chosen(mini: Capture) -> Selected:
    return resolve(find_protocol("smoke"), mini.frames())


@pytest.fixture(scope="module")
def trained(mini: Capture, chosen: Selected) -> tuple[Spy, TrackedPrior]:
    spy = Spy()
    told: list[tuple[str, ...]] = []
    method = TrackedMethod(Tracker(SMALL), spy)
    prior = method.train(mini.recording(chosen.train), 0, lambda *_, **values: told.append(tuple(values)))
    assert ("geometry loss" in told[0]) and told[-1] == ("loss",), "two trainings, told apart"
    return spy, prior


def enrolled(mini: Capture, chosen: Selected, subject: str) -> Recording:
    return mini.recording(frame for frame in chosen.enrol if frame.subject == subject)


def test_training_enrolment_and_queries_have_tracked_meshes(
    mini: Capture, chosen: Selected, trained: tuple[Spy, TrackedPrior]
) -> None:
    spy, prior = trained
    originals = {frame.key: frame for frame in mini.frames()}
    assert [frame.key for frame in spy.trained] == [frame.key for frame in chosen.train]
    assert len({id(frame.mesh) for frame in spy.trained}) == len({frame.pose_key for frame in spy.trained})
    avatar = prior.personalise(enrolled(mini, chosen, "s02"))
    query = next(frame for frame in chosen.scored["unseen-subject"]).query
    drawn = avatar.relight(query)
    for frame in (*spy.trained, *spy.enrolled, spy.asked[-1]):
        before = originals[frame.key if isinstance(frame, Frame) else query.key]
        apart = np.linalg.norm(frame.mesh.vertices - before.mesh.vertices, axis=1)
        assert 0.0 < apart.mean() < 0.006, frame.key  # another mesh of the same hand
        assert frame.camera is before.camera
        if isinstance(frame, Frame):
            assert frame.light is before.light
    assert drawn.mesh is spy.asked[-1].mesh, "its mesh is its own finding, for geometry errors"


def test_a_scored_pose_is_followed_by_its_joints_alone(
    mini: Capture, chosen: Selected, trained: tuple[Spy, TrackedPrior]
) -> None:
    """The capture's mesh of a held-out pose, and every picture of it, may be anything."""
    spy, prior = trained
    avatar = prior.personalise(enrolled(mini, chosen, "s01"))
    query = next(frame for frame in chosen.scored["unseen-segment"]).query
    seen = []
    with watched(mini, seen):
        avatar.relight(query)
    assert not seen, "no picture is read to relight"
    truth = spy.asked[-1].mesh.vertices
    noisy = replace(query.mesh, vertices=query.mesh.vertices + np.random.default_rng(0).normal(0, 1e-3, truth.shape))
    avatar.relight(replace(query, mesh=noisy))
    np.testing.assert_array_equal(spy.asked[-1].mesh.vertices, truth)
    bent = Pose(query.pose.joints * 0.5, query.pose.rotation, query.pose.translation)
    avatar.relight(replace(query, mesh=replace(noisy), pose=bent))
    assert np.abs(spy.asked[-1].mesh.vertices - truth).max() > 1e-3, "its pose is what it follows"


@contextmanager
def watched(capture: Capture, seen: list[str]) -> Iterator[None]:
    real = type(capture).observe

    def observe(self: Capture, frame: Frame) -> Observation:
        seen.append(frame.key)
        return real(self, frame)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(capture), "observe", observe)
        yield


def test_a_pose_that_enrolment_shows_is_tracked_with_its_pictures(
    mini: Capture, chosen: Selected, trained: tuple[Spy, TrackedPrior]
) -> None:
    spy, prior = trained
    enrolment = enrolled(mini, chosen, "s01")
    query = next(frame for frame in chosen.scored["unseen-light"]).query
    assert query.pose_key in {frame.pose_key for frame in enrolment.frames}
    prior.personalise(enrolment).relight(query)
    with_pictures = spy.asked[-1].mesh.vertices
    person = prior.geometry.identify(enrolment)
    views = enrolment.where(lambda frame: frame.pose_key == query.pose_key)
    np.testing.assert_array_equal(with_pictures, prior.geometry.track(person, views).mesh.vertices)
    assert not np.array_equal(
        with_pictures, prior.geometry.follow(person, query.pose, query.mesh.topology).mesh.vertices
    )


def test_meshes_and_poses_that_do_not_belong_are_refused(
    mini: Capture, chosen: Selected, trained: tuple[Spy, TrackedPrior]
) -> None:
    avatar = trained[1].personalise(enrolled(mini, chosen, "s01"))
    query = next(frame for frame in chosen.scored["unseen-segment"]).query
    away = replace(query.mesh, vertices=query.mesh.vertices + 10.0)
    with pytest.raises(Unsupported, match="does not lie where its pose says"):
        avatar.relight(replace(query, mesh=away))
    finer = OpenHand.load().mesh(OpenHand.load().neutral(), query.pose, 2)
    with pytest.raises(Unsupported, match="another resolution"):
        avatar.relight(replace(query, mesh=finer))


@pytest.mark.parametrize(
    ("network", "words"), [("pose_decoder", "tracked surface"), ("identity_decoder", "hand at rest")]
)
def test_weights_that_are_not_finite_are_told(
    mini: Capture, chosen: Selected, trained: tuple[Spy, TrackedPrior], tmp_path: Path, network: str, words: str
) -> None:
    trained[1].save(tmp_path)
    prior = TrackedMethod(Tracker(SMALL), Spy()).load(tmp_path)
    for parameter in getattr(prior.geometry.model, network).parameters():
        torch.nn.init.constant_(parameter, float("nan"))
    with pytest.raises(NonFinite, match=f"geometry: the {words} is not finite"):
        prior.personalise(enrolled(mini, chosen, "s01"))


def test_round_trip(mini: Capture, chosen: Selected, trained: tuple[Spy, TrackedPrior], tmp_path: Path) -> None:
    trained[1].save(tmp_path)
    spy = Spy()
    loaded = TrackedMethod(Tracker(SMALL), spy).load(tmp_path)
    query = next(frame for frame in chosen.scored["unseen-segment"]).query
    for prior in (trained[1], loaded):
        prior.personalise(enrolled(mini, chosen, "s01")).relight(query)
    np.testing.assert_array_equal(spy.asked[-1].mesh.vertices, trained[0].asked[-1].mesh.vertices)
    with pytest.raises(InputError, match="trained with"):
        TrackedMethod(Tracker(replace(SMALL, scan=5.0)), spy).load(tmp_path)


def test_tracking_refuses_unless_it_may_be_blind(
    mini: Capture, chosen: Selected, trained: tuple[Spy, TrackedPrior]
) -> None:
    lit, query = enrolled(mini, chosen, "s01"), next(frame for frame in chosen.scored["unseen-segment"]).query
    with pytest.raises(Unsupported, match="cannot be tracked"):
        Tracking(trained[1].geometry, lit).of(query)
    assert Tracking(trained[1].geometry, lit, blind=True).of(query.viewpoint).mesh.topology is query.mesh.topology


def test_the_protocol_compares_both_meshes(tmp_path: Path) -> None:
    """At smoke size: the columns of protocol `tracked` are those of the same methods."""
    assert {"physical", "physical-tracked"} <= set(find_protocol("tracked").methods)
    sizes = {"texture": "64", "fit_frames": "8"}
    tracked = {f"method.{name}": value for name, value in sizes.items()} | {"geometry.steps": "8"}
    parts = (("physical", sizes), ("physical-tracked", tracked))
    small = [Setting(name, value, method) for method, values in parts for name, value in values.items()]
    outcome = run(find_protocol("smoke"), methods=["physical", "physical-tracked"], out=tmp_path, settings=small)
    assert (outcome.computed, outcome.crashed) == (4, ())
    found: dict[str, list[float]] = {}
    for cell in flat_cells(tmp_path):
        values = [s["value"] for s in cell["scores"] if s["metric"].startswith("psnr")]
        found.setdefault(cell["method"]["name"], []).extend(values)
        assert cell["same_pixels"] is True and cell["method"]["linear"]
    own, tracked = (np.array(found[name]) for name in ("physical", "physical-tracked"))
    assert own.shape == tracked.shape and (own != tracked).all(), "other meshes give other pictures"
    assert np.abs(own - tracked).mean() < 4.0, "of the same hand"


def test_the_family_is_registered_with_every_preset_of_its_methods() -> None:
    for name in ("physical-tracked", "urhand-tracked"):
        for preset in ("smoke", "quick", "standard", "paper"):
            made = METHODS.load(name)(preset=preset)
            assert made.info.name == name and made.info.title.endswith(", tracked")
            assert set(made.config) == {"geometry", "method"}
        with pytest.raises(InputError, match="did you mean 'quick'"):
            METHODS.load(name)(preset="quik")
