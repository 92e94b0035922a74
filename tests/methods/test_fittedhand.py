"""A person's hand is found in the pictures of an enrolment and posed as asked, or there is a reason why not."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from benchmarks.fitting import Sitter, sitter
from handbench.errors import Unsupported
from handbench.hand.fitting import FittingSettings, HandPicture
from handbench.methods.kit.fittedhand import FITTABLE, FittedHand, fitted_hand
from handbench.recording import Recording
from handbench.scene import Frame, Observation, Pose, Unknown, Viewpoint

find = partial(fitted_hand, settings=FittingSettings(level=0, starts=1, steps=10))


@pytest.fixture(scope="module")
def someone() -> Sitter:
    return sitter(np.random.default_rng(11))


@pytest.fixture(scope="module")
def picture(someone: Sitter) -> HandPicture:
    return someone.picture(np.random.default_rng(0), depth=True)


def recorded(someone: Sitter, *pictures: HandPicture, gives: frozenset = FITTABLE | {"depth"}, sure: float = 1.0):
    """The enrolment that consists of these pictures."""
    lit = "room", None, None, someone.camera, Unknown("room"), "scan", "environment"
    frames = [Frame("s01", f"moment-{i}", *lit) for i in range(len(pictures))]
    seen = {
        frame.key: Observation(
            np.ones((*p.alpha.shape, 3)) * p.alpha[..., None] * [0.5, 0.4, 0.3],
            p.alpha,
            depth=p.depth,
            keypoints=np.c_[np.nan_to_num(p.key_points), np.where(np.isnan(p.key_points[:, 0]), 0.0, sure)],
        )
        for frame, p in zip(frames, pictures, strict=True)
    }
    return Recording(frames, lambda frame: seen[frame.key], gives)


@pytest.fixture(scope="module")
def found(someone: Sitter, picture: HandPicture) -> FittedHand:
    nothing = replace(picture, key_points=np.full((21, 2), np.nan))
    return find(recorded(someone, picture, nothing))


def test_the_hand_is_posed_as_it_is_asked_for(someone: Sitter, found: FittedHand) -> None:
    pose = Pose(someone.hand.named_pose("rest").joints, (0.1, 0.7, -0.2), (0.03, -0.02, 0.1))
    asked = Viewpoint("s01", "other", pose, None, someone.camera)
    mesh, true = found.posed(asked), someone.hand.mesh(someone.shape, pose, found.level)
    assert np.linalg.norm(mesh.vertices - true.vertices, axis=1).mean() < 0.005
    assert mesh.topology is found.posed(asked).topology and mesh.topology.uvs is not None


def test_frames_without_a_hand_are_left_out(someone: Sitter, found: FittedHand) -> None:
    assert [sighting.frame.pose_name for sighting in found.sightings] == ["moment-0"]


def test_what_a_frame_shows_has_the_colour_of_its_picture(
    someone: Sitter, picture: HandPicture, found: FittedHand
) -> None:
    (shown,) = found.shown(recorded(someone, picture, picture), 64)
    seen = shown.seen.weight > 0
    assert 0.15 < seen.mean() < 0.7, "one side of the hand"
    assert np.allclose(shown.seen.colour[:, seen].T, [0.5, 0.4, 0.3], atol=5e-3)


@pytest.mark.parametrize(
    ("change", "sure", "reason"),
    [
        ({"key_points": np.full((21, 2), np.nan)}, 1.0, "moment-0.*no key points are given"),
        ({}, 0.2, "no key points are given"),
        ({"alpha": np.zeros((512, 384))}, 1.0, "the mask covers 0 pixels"),
        ({"depth": 1000.0}, 1.0, "millimetres"),
    ],
)
def test_what_cannot_be_fitted_is_a_reason(
    someone: Sitter, picture: HandPicture, change: dict, sure: float, reason: str
) -> None:
    scaled = {"depth": picture.depth * change["depth"]} if "depth" in change else change
    with pytest.raises(Unsupported, match=reason):
        find(recorded(someone, replace(picture, **scaled), sure=sure))


def test_key_points_that_are_not_given_are_a_reason(someone: Sitter, picture: HandPicture) -> None:
    with pytest.raises(Unsupported, match="the set of key points is not given"):
        find(recorded(someone, picture, gives=frozenset({"image", "alpha", "camera"})))


def test_the_pose_of_another_hand_model_is_refused(someone: Sitter, found: FittedHand) -> None:
    asked = Viewpoint("s01", "other", Pose(np.zeros((16, 3))), None, someone.camera)
    with pytest.raises(Unsupported, match="the pose has 16 joints"):
        found.posed(asked)
