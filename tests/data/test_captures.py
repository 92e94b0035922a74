"""Scans, hands in the wild and scans by phone: what methods are given, how wrong it is, and what is true."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from typing import get_args

import numpy as np
import pytest
from quicktracer import Quick
from scipy.spatial.transform import Rotation

from handbench.data.capture import Capture
from handbench.data.contactsheet import contact_sheet
from handbench.data.openstage import PRESETS, open_capture, preset
from handbench.data.openstage import make as module
from handbench.data.openstage.estimates import ONE_CAMERA, estimated_poses, estimated_shape, keypoints
from handbench.data.openstage.plans import production
from handbench.data.openstage.population import PEOPLE, cast
from handbench.data.openstage.presets import CaptureName
from handbench.data.openstage.rooms import PANELS, panels, room, studio
from handbench.data.openstage.stage import ENVIRONMENT_IRRADIANCE, cameras
from handbench.data.openstage.tattoo import HELD_OUT
from handbench.data.openstage.wild import path
from handbench.hand.collision import penetration
from handbench.hand.openhand import OpenHand, named_pose
from handbench.light.environment import solid_angles
from handbench.recording import Part, Recording
from handbench.render.see.raster import rasterise
from handbench.scene import Environment, Frame, Point, Pose, Unknown
from handbench.scene.colour import eight_bit, linear

HAND = OpenHand.load()
CAMERA = cameras(preset("quick"), ["palmar"])[0]


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[CaptureName], Capture]]:
    """The smallest size of a capture; pictures are drawn in no time, the rest is as it is made."""
    folder, made = tmp_path_factory.mktemp("captures"), {}

    def open_(name: CaptureName) -> Capture:
        made[name] = made.get(name) or open_capture("mini", folder, capture=name)
        return made[name]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "PathTracer", Quick)
        patch.setattr(module, "difference", lambda manifest, folder: None)
        yield open_


def of(capture: Capture, segment: str) -> list[Frame]:
    return [frame for frame in capture.frames() if frame.segment == segment]


# --- people ---------------------------------------------------------------------------------------------------------


def test_no_person_is_in_two_captures() -> None:
    everybody = [index for people in PEOPLE.values() for index in people]
    assert len(set(everybody)) == len(everybody) and set(PEOPLE) == set(get_args(CaptureName))
    for name, sizes in PRESETS.items():
        assert all(size.subjects <= len(PEOPLE[name]) for size in sizes.values())


def test_half_of_the_people_of_a_phone_are_dark_and_half_have_tattoos_that_nobody_else_has() -> None:
    phone = cast("openphone", 4, HAND)
    assert sum(person.look.melanin > 0.8 for person in phone) == 2
    assert sum(bool(person.look.tattoos) for person in phone) == 2
    drawn = {tattoo.name for person in phone for tattoo in person.look.tattoos}
    assert drawn == set(HELD_OUT)
    others = [person for name in PEOPLE if name != "openphone" for person in cast(name, 24, HAND)]
    assert not drawn & {tattoo.name for person in others for tattoo in person.look.tattoos}


# --- what is given, and what is true ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "segment", "gives"),
    [
        ("openwild", "sequence", {"image", "alpha", "camera", "pose", "shape", "keypoints"}),
        ("openphone", "scan", {"image", "alpha", "camera", "depth", "keypoints"}),
        ("openscans", "scan", {"image", "alpha", "camera", "normal", "depth", "pose", "shape", "scan"}),
    ],
)
def test_a_recording_hands_over_what_is_given_and_no_more(
    opened: Callable[[CaptureName], Capture], name: CaptureName, segment: str, gives: set[Part]
) -> None:
    capture = opened(name)
    frames = of(capture, segment)
    recording = Recording(frames, capture.observe, frozenset(gives))
    assert gives <= capture.offers
    for frame in recording.frames:
        seen = recording.observe(frame)
        there = {"image", "camera"}
        there |= {
            part for part in ("alpha", "depth", "normal", "uv", "keypoints", "scan") if getattr(seen, part) is not None
        }
        there |= {part for part in ("pose", "shape", "mesh") if getattr(frame, part) is not None}
        assert there == gives
        assert isinstance(frame.light, Unknown) and frame.lighting.startswith("light-")
    assert len({frame.lighting for frame in recording.of_subject(frames[0].subject).frames}) == 1, "one light a subject"


@pytest.mark.parametrize(("name", "segment"), [("openwild", "sequence"), ("openphone", "scan"), ("openscans", "scan")])
def test_frames_to_enrol_tell_estimates_and_the_truth_is_near(
    opened: Callable[[CaptureName], Capture], name: CaptureName, segment: str
) -> None:
    capture = opened(name)
    for frame in of(capture, segment):
        true = capture.truth(frame)
        told = HAND.mesh(frame.shape, frame.pose, 1).vertices
        off = np.linalg.norm(told - true.mesh.vertices, axis=1).mean()
        assert 5e-4 < off < 2.5e-2 and frame.mesh is None
        assert np.array_equal(capture.truth(true).mesh.vertices, true.mesh.vertices)


def test_scored_frames_tell_the_true_pose_and_not_the_true_shape(opened: Callable[[CaptureName], Capture]) -> None:
    for name in ("openwild", "openphone"):
        capture = opened(name)
        for frame in capture.frames():
            if frame.segment not in ("sequence", "scan"):
                true = capture.truth(frame)
                assert np.array_equal(frame.pose.joints, true.pose.joints)
                assert not np.allclose(frame.shape, true.shape)


def test_the_first_moment_and_the_whole_sequence_can_be_enrolled(opened: Callable[[CaptureName], Capture]) -> None:
    capture, size = opened("openwild"), preset("mini", "openwild")
    subject = capture.frames()[0].subject
    moments = [frame.moment for frame in of(capture, "sequence") if frame.subject == subject]
    assert moments == list(range(size.moments))
    later = [frame.moment for frame in of(capture, "later") if frame.subject == subject]
    assert later == list(range(size.moments, size.moments + size.later))
    relit = of(capture, "relit")
    assert {frame.lighting for frame in relit} == {"relit-crossroads", "relit-konzerthaus", "lamp"}
    assert all(isinstance(frame.light, Point) for frame in relit if frame.lighting == "lamp")
    assert {frame.camera.name for frame in of(capture, "elsewhere")} == {"palm-radial", "palm-ulnar"}
    assert all(np.isfinite(capture.observe(frame).image).all() for frame in capture.frames())


def test_a_scan_is_the_true_surface_with_its_relief(opened: Callable[[CaptureName], Capture]) -> None:
    capture = opened("openscans")
    frame = capture.frames()[0]
    scan = capture.observe(frame).scan
    smooth = HAND.mesh(capture.truth(frame).shape, capture.truth(frame).pose, preset("mini", "openscans").scan_level)
    off = np.linalg.norm(scan.vertices - smooth.vertices, axis=1)
    assert 1e-6 < off.max() < 1.5e-3 and scan.topology.uvs is None
    drawn = rasterise(scan, frame.camera)
    assert np.abs(drawn.alpha - capture.observe(frame).alpha).mean() < 0.01


def test_a_phone_tells_codes_ragged_masks_and_depth_with_holes(opened: Callable[[CaptureName], Capture]) -> None:
    capture = opened("openphone")
    holes, ragged = [], []
    for frame in of(capture, "scan"):
        seen, true = capture.observe(frame), rasterise(capture.truth(frame).mesh, frame.camera)
        codes = eight_bit(seen.image)
        assert np.allclose(linear(codes / 255.0), seen.image, rtol=1e-3, atol=1e-6), "256 codes, as half floats"
        assert set(np.unique(seen.alpha)) == {0.0, 1.0} and seen.normal is None
        inside = true.alpha > 0.99
        ragged.append(np.mean((seen.alpha > 0.5) != (true.alpha > 0.5)))
        told = seen.depth[inside & (seen.depth > 0)]
        holes.append(np.mean(seen.depth[inside] == 0))
        assert np.allclose(told, np.round(told, 3), atol=1e-5), "whole millimetres"
        error = told - true.mean(true.depth[:, None])[..., 0][inside & (seen.depth > 0)]
        assert 5e-4 < np.median(np.abs(error)) < 4e-3
    assert 0.02 < np.mean(holes) < 0.5 and 1e-3 < np.mean(ragged) < 0.05
    for frame in of(capture, "relit"):
        seen = capture.observe(frame)
        assert seen.normal is not None and seen.keypoints is None and len(np.unique(seen.alpha)) > 2
    assert {frame.lighting for frame in of(capture, "relit")} >= set(PANELS)
    assert "normal" not in capture.offers and "depth" in capture.offers


@pytest.mark.parametrize("name", ["openscans", "openwild", "openphone"])
def test_every_capture_has_a_contact_sheet(opened: Callable[[CaptureName], Capture], name: CaptureName) -> None:
    sheet = np.asarray(contact_sheet(opened(name), cell_height=32))
    assert sheet.max() > 60 and sheet.shape[0] > 64


# --- errors -----------------------------------------------------------------------------------------------------------


def test_errors_of_a_tracker_are_as_large_as_it_says_and_stay_for_a_while() -> None:
    still = [Pose(named_pose("rest").joints)] * 4000
    told = estimated_poses(HAND, still, ONE_CAMERA, CAMERA, np.random.default_rng(0))
    steps = np.array([pose.translation for pose in told]) @ CAMERA.rotation.T
    assert np.allclose(steps.std(axis=0), [ONE_CAMERA.across, ONE_CAMERA.across, ONE_CAMERA.along], rtol=0.15)
    turns = np.degrees([pose.rotation for pose in told])
    assert np.allclose(turns.std(axis=0), ONE_CAMERA.rotation, rtol=0.15)
    after = [np.corrcoef(steps[:-1, i], steps[1:, i])[0, 1] for i in range(3)]
    assert np.allclose(after, ONE_CAMERA.memory, atol=0.03)
    joints = np.array([pose.joints for pose in told])
    assert (joints >= HAND.limits[..., 0] - 1e-9).all() and (joints <= HAND.limits[..., 1] + 1e-9).all()
    fixed = HAND.limits[..., 0] == HAND.limits[..., 1]
    assert not (joints - still[0].joints)[:, fixed].any() and joints[:, ~fixed].std(axis=0).min() > 0


def test_a_detector_is_off_by_one_to_two_pixels_and_sometimes_lost() -> None:
    rng, pose = np.random.default_rng(1), named_pose("open")
    true, _ = CAMERA.project(HAND.posed(HAND.neutral(), pose)[1][list(HAND.key_points)])
    seen = np.array([keypoints(HAND, HAND.neutral(), pose, CAMERA, rng) for _ in range(120)])
    off = np.linalg.norm(seen[..., :2] - true, axis=-1)
    lost = off > 8.0
    assert 0.01 < lost.mean() < 0.04 and 1.0 < (seen[..., :2] - true)[~lost].std() < 2.0
    assert (
        seen[..., 2].min() >= 0 and seen[..., 2].max() <= 1 and seen[..., 2][lost].mean() < seen[..., 2][~lost].mean()
    )


def test_estimated_shapes_are_off_by_millimetres() -> None:
    rng, rest = np.random.default_rng(2), named_pose("rest")
    true = HAND.neutral()
    for _ in range(5):
        told = HAND.mesh(estimated_shape(HAND, true, rng), rest, 0).vertices
        assert 5e-4 < np.linalg.norm(told - HAND.mesh(true, rest, 0).vertices, axis=1).mean() < 6e-3


def test_a_hand_in_the_wild_moves_smoothly_and_not_through_itself() -> None:
    subject = cast("openwild", 1, HAND)[0]
    poses = path(HAND, subject, 27, CAMERA, np.random.default_rng(3))
    meshes = [HAND.mesh(subject.identity, pose, 0).vertices for pose in poses]
    speed = [np.linalg.norm(b - a, axis=1).max() for a, b in pairwise(meshes)]
    assert max(speed) < 0.05 and max(speed) < 8 * np.median(speed), "metres a moment"
    assert all(penetration(HAND, HAND.skin(subject.identity, p.joints).numpy().astype(float)).free for p in poses[::5])
    turned = [Rotation.from_rotvec(pose.rotation.copy()) for pose in poses]
    assert max((b * a.inv()).magnitude() for a, b in pairwise(turned)) < np.radians(20)


@pytest.mark.parametrize(
    "made", [partial(studio, 32), partial(room, "room", "hall", 5, 32), *(partial(panels, name, 32) for name in PANELS)]
)
def test_rooms_are_exposed_like_sky_boxes(made: Callable[[], Environment]) -> None:
    light = made()
    power = (light.radiance * solid_angles(32, 64)[..., None]).sum() / 3
    assert np.isclose(power / 4, ENVIRONMENT_IRRADIANCE, rtol=1e-3)


def test_every_preset_is_a_recipe_of_its_own() -> None:
    every = [size for sizes in PRESETS.values() for size in sizes.values()]
    assert len({size.recipe for size in every}) == len(every)
    scans, wild, phone = (PRESETS[name]["quick"] for name in ("openscans", "openwild", "openphone"))
    assert scans.subjects >= 24 and scans.poses >= 6 and len(scans.cameras) >= 8
    assert PRESETS["openscans"]["standard"].subjects == 48
    assert wild.subjects >= 12 and wild.moments >= 21 and phone.subjects >= 4 and phone.moments == 60
    plan = production(PRESETS["openscans"]["mini"])
    assert [one.key for one in plan.performances] == ["s25/pose-0", "s25/pose-1", "s26/pose-0", "s26/pose-1"]
