"""Hands are found where they are, and what cannot be fitted or was missed is told, never returned as a hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.fitting import CaptureNoise, Sitter, errors, sitter
from benchmarks.spoiled import in_a_mirror, zoomed
from handbench.errors import InputError, Unsupported
from handbench.hand import hand_model
from handbench.hand.fitting import Fit, FittingSettings, HandPicture, Unfittable, fit, pictures, starts
from handbench.hand.fitting.picture import CloseUp
from handbench.hand.fitting.placed import in_camera, in_world
from handbench.hand.fitting.space import Space
from handbench.recording import Recording
from handbench.scene import Directional, Frame, Observation, Pose

BRIEF = FittingSettings(starts=1, steps=12)


@pytest.fixture(scope="module")
def someone() -> Sitter:
    return sitter(np.random.default_rng(11))


@pytest.fixture(scope="module")
def flat(someone: Sitter) -> HandPicture:
    return someone.picture(np.random.default_rng(0), depth=False)


@pytest.fixture(scope="module")
def deep(someone: Sitter) -> HandPicture:
    return someone.picture(np.random.default_rng(0), depth=True)


@pytest.fixture(scope="module")
def found(deep: HandPicture) -> Fit:
    return fit(hand_model(), [deep], BRIEF)


def test_one_picture_with_depth(someone: Sitter, found: Fit) -> None:
    assert found.converged and not found.problems, found.problems
    assert errors(someone, found).absolute < 0.004
    (own,) = found.pictures
    assert own.key_points < 4 and own.overlap is not None and own.overlap > 0.9
    assert own.depth is not None and own.depth < 0.004


def test_one_picture_without_depth_up_to_the_distance(someone: Sitter, flat: HandPicture) -> None:
    fitted = fit(hand_model(), [flat], replace(BRIEF, starts=2, steps=16))
    assert fitted.converged, fitted.reason
    assert errors(someone, fitted).scaled < 0.009  # 5 mm is usual: `benchmarks.fitting_captures`
    assert {problem.kind for problem in fitted.problems} == {"distance", "other hand"}


def test_a_sequence_has_one_shape_and_pictures_without_a_hand_are_left_out(someone: Sitter) -> None:
    rng = np.random.default_rng(5)
    turned = [
        replace(someone, pose=Pose(someone.pose.joints, [0.2, angle, 0.1], someone.pose.translation))
        for angle in (-0.6, -0.2, 0.2, 0.6)
    ]
    pictures = [sitting.picture(rng, True, f"frame {i}") for i, sitting in enumerate(turned)]
    pictures[2] = replace(pictures[2], key_points=np.full((21, 2), np.nan))
    fitted = fit(hand_model(), pictures, replace(BRIEF, steps=10, together=2))
    assert fitted.converged, fitted.reason
    assert [own.pose is None for own in fitted.pictures] == [False, False, True, False]
    assert [problem.kind for problem in fitted.problems] == ["no key points"]
    for i in (0, 1, 3):
        assert errors(turned[i], fitted, i).absolute < 0.004


def test_a_start_that_is_given_is_tried_as_it_is(
    someone: Sitter, flat: HandPicture, monkeypatch: pytest.MonkeyPatch
) -> None:
    space, camera = Space.of(someone.hand, 1), someone.camera
    given = in_camera(space, someone.pose, camera)
    back = in_world(space, given, camera)
    np.testing.assert_allclose(back.joints, someone.pose.joints, atol=1e-9)
    np.testing.assert_allclose(back.rotation, someone.pose.rotation, atol=1e-9)
    np.testing.assert_allclose(back.translation, someone.pose.translation, atol=1e-9)
    monkeypatch.setattr(starts, "STEPS", 0)  # nothing else can be as good
    lost, led = (starts.starts(space, CloseUp.of(flat), 1, also)[0] for also in ((), (given,)))
    assert led.hand.angles is not lost.hand.angles and led.missed < 0.3 * lost.missed


def test_the_other_hand_is_told(deep: HandPicture) -> None:
    fitted = fit(hand_model(), [in_a_mirror(deep)], BRIEF)
    assert not fitted.converged and "left hand" in fitted.reason
    assert "other hand" in [problem.kind for problem in fitted.problems]


def test_key_points_of_no_hand_are_told(flat: HandPicture) -> None:
    shuffled = replace(flat, key_points=np.random.default_rng(0).permutation(flat.key_points))
    fitted = fit(hand_model(), [shuffled], BRIEF)
    assert not fitted.converged and "no hand" in [problem.kind for problem in fitted.problems]


def kind(picture: HandPicture) -> str:
    with pytest.raises(Unfittable) as caught:
        fit(hand_model(), [picture], BRIEF)
    assert isinstance(caught.value, InputError) and "picture: " in str(caught.value)
    return caught.value.problems[0].kind


def test_what_cannot_be_fitted_is_refused_with_the_reason(deep: HandPicture) -> None:
    assert deep.alpha is not None and deep.depth is not None
    few = deep.key_points.copy()
    few[5:] = np.nan
    assert kind(replace(deep, key_points=few)) == "no key points"
    assert kind(replace(deep, alpha=np.zeros_like(deep.alpha))) == "empty mask"
    assert kind(replace(deep, depth=1000 * deep.depth)) == "depth unit"
    two = deep.alpha.copy()
    two[2:100, 2:150] = 1.0
    assert kind(replace(deep, alpha=two)) == "two hands"


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_wrong_focal_length_is_told_by_depth(deep: HandPicture, factor: float) -> None:
    assert kind(replace(deep, camera=zoomed(deep.camera, factor))) == "focal length"


def test_an_absurd_focal_length_is_told_without_depth(flat: HandPicture) -> None:
    millimetres = zoomed(flat.camera, 0.05)  # for pixels
    assert kind(replace(flat, camera=millimetres)) == "focal length"


def test_two_hands_that_touch_are_told(flat: HandPicture) -> None:
    assert flat.alpha is not None
    rows, columns = np.nonzero(flat.alpha > 0.5)
    both = flat.alpha.copy()
    both[rows.min() : rows.max(), max(columns.min() - 90, 0) : int(columns.mean())] = 1.0
    fitted = fit(hand_model(), [replace(flat, alpha=both)], BRIEF)
    assert not fitted.converged and {"two hands", "missed"} & {problem.kind for problem in fitted.problems}


def test_a_hand_that_the_edge_cuts_is_told_and_still_found(someone: Sitter) -> None:
    camera = someone.camera
    _, points = someone.hand.posed(someone.shape, someone.pose)
    places = camera.project(points[list(someone.hand.key_points)])[0]
    edge = int(np.sort(places[:, 1])[4])  # four key points are above
    K = camera.K.copy()
    K[1, 2] -= edge
    cut = replace(someone, camera=replace(camera, K=K, height=camera.height - edge))
    fitted = fit(hand_model(), [cut.picture(np.random.default_rng(0), True)], BRIEF)
    assert "cut" in [problem.kind for problem in fitted.problems]
    assert fitted.converged, fitted.reason


def test_arrays_that_do_not_fit_are_refused(flat: HandPicture) -> None:
    assert flat.alpha is not None
    with pytest.raises(InputError, match=r"expected \(21, 2\)"):
        replace(flat, key_points=np.zeros((20, 2)))
    with pytest.raises(InputError, match="alpha has shape"):
        replace(flat, alpha=flat.alpha[1:])
    with pytest.raises(InputError, match="NaN"):
        replace(flat, depth=np.full_like(flat.alpha, np.nan))


def test_noise_is_what_it_says() -> None:
    clean = replace(sitter(np.random.default_rng(2)), noise=CaptureNoise(0, 0, 0, 0, 0, 0))
    picture = clean.picture(np.random.default_rng(0), True)
    places = clean.camera.project(clean.hand.posed(clean.shape, clean.pose)[1][list(clean.hand.key_points)])[0]
    np.testing.assert_allclose(picture.key_points, places)


def test_a_recording_is_a_sequence_of_pictures(someone: Sitter, deep: HandPicture) -> None:
    light = Directional([0.0, 1.0, 0.0], [1.0, 1.0, 1.0])
    frames = [
        Frame("s", f"p{k}", "full", someone.pose, None, someone.camera, light, "scan", "full", moment=k) for k in (1, 0)
    ]
    points = np.c_[deep.key_points, np.linspace(0.0, 1.0, 21)]
    image = np.zeros((*deep.alpha.shape, 3))

    def observe(frame: Frame) -> Observation:
        return Observation(image, deep.alpha, depth=deep.depth, keypoints=points)

    given = pictures(Recording(frames, observe))
    assert [picture.name for picture in given] == ["s/p0/phone/full", "s/p1/phone/full"]
    assert given[0].start is not None and given[0].depth is not None
    assert not given[0].seen[:2].any() and given[0].seen[3:].all()  # a detector's guesses are not seen
    least = pictures(Recording(frames, observe, frozenset({"image", "camera", "keypoints"})))
    assert least[0].start is None and least[0].depth is None and least[0].alpha is None
    with pytest.raises(Unsupported, match="key points is not given"):
        pictures(Recording(frames, observe, frozenset({"image", "camera"})))
    with pytest.raises(Unsupported, match="calibration"):
        pictures(Recording(frames, observe, frozenset({"image", "keypoints"})))
    with pytest.raises(Unsupported, match="one subject"):
        pictures(Recording([*frames, replace(frames[0], subject="t")], observe))
