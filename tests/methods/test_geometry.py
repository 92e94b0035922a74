"""The hand geometry autoencoder on the mini capture: its parts against outside truth, training, tracking, refusals."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from handbench.data.capture import Capture
from handbench.data.openstage import open_capture
from handbench.errors import InputError, Unsupported
from handbench.hand.openhand import OpenHand, sample_pose
from handbench.method import Recording
from handbench.methods.geometry import GeometryPrior, Tracker, Tracking, create, nearest
from handbench.methods.geometry.config import GeometryConfig
from handbench.methods.geometry.model import _NEAR, GeometryModel, combined
from handbench.methods.geometry.nearest import closest
from handbench.methods.geometry.networks import divergence
from handbench.methods.geometry.neutral import neutral, warped
from handbench.methods.geometry.scan import depth_maps, point_cloud, square_picture
from handbench.methods.geometry.skeleton import ToldPose, pose_told_by, posed_points, regressor
from handbench.methods.geometry.training import Lesson, laplacian
from handbench.methods.kit.weights import save_state
from handbench.metrics.geometry.points import point_error
from handbench.metrics.geometry.surface import surface_distances
from handbench.scene import Camera, Frame, Mesh, Observation, Pose
from handbench.studies.geometry.study import geometry_report, run

SMALL = GeometryConfig(image=32, depth=32, points=400, steps=4, warmup=1, code=8)
HAND = OpenHand.load()


@pytest.fixture(scope="module")
def mini() -> Capture:
    return open_capture("mini")


@pytest.fixture(scope="module")
def lit(mini: Capture) -> Recording:
    """Fully lit training frames of both subjects."""
    return mini.recording(f for f in mini.frames() if f.kind == "full" and f.segment == "train")


@pytest.fixture(scope="module")
def prior(lit: Recording) -> GeometryPrior:
    return Tracker(SMALL).train(lit)


def model(config: GeometryConfig = SMALL) -> GeometryModel:
    torch.manual_seed(0)
    return GeometryModel(config, HAND, level=1)


def sight(frame: Frame, turn: Rotation, shift: np.ndarray) -> Frame:
    """A frame after its whole world, hand and camera, was moved rigidly: the same picture."""
    camera, pose, around = frame.camera, frame.pose, turn.as_matrix()
    rotation = camera.world_to_camera[:, :3] @ around.T
    placed = np.column_stack([rotation, camera.world_to_camera[:, 3] - rotation @ shift])
    return replace(
        frame,
        camera=Camera(camera.name, camera.width, camera.height, camera.K, placed),
        mesh=Mesh(frame.mesh.vertices @ around.T + shift, frame.mesh.topology),
        pose=Pose(
            pose.joints,
            (turn * Rotation.from_rotvec(pose.rotation.copy())).as_rotvec(),
            turn.apply(pose.translation.copy()) + shift,
        ),
    )


# -- parts ------------------------------------------------------------------------------------------------------


def test_the_regressor_finds_joints_of_hands_it_has_not_seen() -> None:
    rng = np.random.default_rng(0)
    apart, before = [], []
    for _ in range(10):
        identity = HAND.sample_identity(rng)
        vertices, joints = HAND.rest(identity, torch.float64)
        found = regressor(HAND, 1) @ HAND.subdivide(vertices, 1).numpy()
        apart.append(np.linalg.norm(found[: len(joints)] - joints.numpy(), axis=1).mean())
        before.append(np.linalg.norm(HAND.template.points[: len(joints)] - joints.numpy(), axis=1).mean())
    assert np.mean(apart) < 0.6e-3 < 3e-3 < np.mean(before)


def test_the_regressor_is_exact_on_affine_images_of_the_template() -> None:
    rng = np.random.default_rng(1)
    stretch, shift = np.eye(3) + 0.2 * rng.standard_normal((3, 3)), rng.standard_normal(3)
    found = regressor(HAND, 1) @ (HAND.rest_position(1) @ stretch + shift)
    np.testing.assert_allclose(found, HAND.template.points @ stretch + shift, atol=1e-9)


def test_directions_put_every_joint_where_it_was_seen() -> None:
    rng = np.random.default_rng(2)
    for _ in range(5):
        pose = Pose(sample_pose(rng).joints, rng.normal(size=3), rng.normal(size=3))
        observed = posed_points(HAND, HAND.points, pose)
        tensors = pose_told_by(HAND, torch.tensor(HAND.points), torch.tensor(observed))
        told = combined(tensors, torch.zeros(len(HAND.parents) + 2, 3))
        np.testing.assert_allclose(posed_points(HAND, HAND.points, told), observed, atol=1e-9)
        flexion = [HAND.joint_names.index(f"index{k}") for k in (2, 3)]  # hinges: a swing tells all
        np.testing.assert_allclose(told.joints[flexion, 0], pose.joints[flexion, 0], atol=0.03)


def test_divergence_is_torchs() -> None:
    torch.manual_seed(0)
    mean, log_variance = torch.randn(3, 5), torch.randn(3, 5)
    own = torch.distributions.Normal(mean, (0.5 * log_variance).exp())
    truth = torch.distributions.kl_divergence(own, torch.distributions.Normal(0.0, 1.0)).sum(-1)
    torch.testing.assert_close(divergence(mean, log_variance), truth)


def test_without_offsets_the_surface_is_the_open_hands() -> None:
    """LBS against `OpenHand.mesh`, which is tested against its own truth."""
    net, rng = model(), np.random.default_rng(3)
    for layer in (net.identity_decoder.layers.last, net.identity_decoder.straight, net.pose_decoder.layers.last):
        torch.nn.init.zeros_(layer.weight)
    pose = Pose(sample_pose(rng).joints, rng.normal(size=3), rng.normal(size=3))
    turn = Rotation.from_rotvec(pose.rotation.copy()).as_matrix()
    told = ToldPose(*(torch.tensor(part) for part in (pose.joints, turn, pose.translation)))
    posed = net.posed(net.shape(torch.randn(SMALL.code)), told, net.still)
    truth = HAND.mesh(HAND.neutral(), pose, 1).vertices
    assert np.abs(posed.vertices.detach().numpy() - truth).max() < 1e-6
    np.testing.assert_allclose(posed.points.detach(), posed_points(HAND, HAND.points, pose), atol=1e-6)


def test_without_a_tree_the_nearest_points_are_the_same() -> None:
    """Other devices compare each point with each triangle; here the CPU does."""
    mesh = HAND.mesh(HAND.neutral(), sample_pose(np.random.default_rng(5)), 0)
    vertices, corners = torch.tensor(mesh.vertices).float(), torch.tensor(mesh.topology.faces.astype(np.int64))
    corners = torch.cat([corners, torch.zeros(1, 3, dtype=torch.int64)])  # a triangle without area
    rng = np.random.default_rng(3)
    points = vertices[rng.choice(len(vertices), 120)] + torch.from_numpy(rng.normal(0, 0.004, (120, 3))).float()
    apart = []
    for find in (nearest.by_embree, nearest.by_all):
        face, u, v = find(vertices, corners, points)
        assert (u >= 0).all() and (v >= 0).all() and (u + v <= 1 + 1e-6).all()
        weights = torch.stack([1 - u - v, u, v], dim=1)[..., None]
        apart.append(((weights * vertices[corners[face]]).sum(dim=1) - points).norm(dim=1))
    assert apart[0].max() > 0.005 and (apart[0] - apart[1]).abs().max() < 1e-6


def test_closest_points_are_on_the_surface_and_differentiable() -> None:
    mesh = HAND.mesh(HAND.neutral(), Pose(np.zeros((21, 3))), 1)
    vertices = torch.tensor(mesh.vertices).float().requires_grad_()
    points = vertices.detach()[::50] + torch.tensor([0.0, 0.0, 0.003])
    near = closest(vertices, mesh.topology.faces, points)
    apart = 1e3 * (near - points).norm(dim=1)
    np.testing.assert_allclose(apart.detach(), surface_distances(mesh, points.numpy()), atol=1e-3)
    near.sum().backward()
    torch.testing.assert_close(vertices.grad.sum(), torch.tensor(3.0 * len(points)))  # barycentric weights sum to one


def test_laplacian_of_a_constant_is_zero_and_of_a_spike_is_not() -> None:
    count = len(HAND.template.vertices)
    assert (laplacian(HAND, torch.device("cpu")) @ torch.ones(count, 1)).abs().max() < 1e-6
    spike = torch.zeros(count, 1)
    spike[7] = 1.0
    assert (laplacian(HAND, torch.device("cpu")) @ spike)[7] == 1.0


def test_scans_lie_on_the_tracked_surface(lit: Recording) -> None:
    """Truth has creases and the tracked mesh noise; a wrong half pixel or axis would show as 1 mm and more."""
    for frame in lit.frames[:4]:
        distances = surface_distances(frame.mesh, point_cloud([(frame, lit.observe(frame))]).points)
        assert distances.mean() < 0.25 and np.percentile(distances, 99) < 1.5


def test_the_picture_is_cut_around_the_hand(lit: Recording) -> None:
    frame = lit.frames[0]
    found = neutral(lit.of_subject(frame.subject)).observed(frame.pose)
    seen = square_picture(np.repeat(lit.observe(frame).alpha[..., None], 3, 2), frame.camera, found, 64)
    rows, columns = (np.flatnonzero(seen[0].numpy().max(axis=axis) > 0.5) for axis in (1, 0))
    assert rows[0] > 0 and len(rows) > 30 and 15 < len(columns) < 64


# -- what the inputs are normalised by --------------------------------------------------------------------------


def test_a_moved_world_has_the_same_code_and_a_moved_hand(lit: Recording, prior: GeometryPrior) -> None:
    turn, shift = Rotation.from_rotvec([0.5, -1.1, 2.0]), np.array([0.4, -0.2, 1.5])
    here = lit.of_subject("s01")
    originals = {frame.key: frame for frame in here.frames}
    there = Recording((sight(f, turn, shift) for f in here.frames), lambda f: here.observe(originals[f.key]))
    one, other = prior.identify(here), prior.identify(there)
    torch.testing.assert_close(other.shape.code, one.shape.code, atol=1e-5, rtol=1e-4)
    pose = lambda frames: frames.where(lambda f: f.pose_name == "pose-1")  # noqa: E731
    before, after = prior.track(one, pose(here)), prior.track(other, pose(there))
    np.testing.assert_allclose(after.mesh.vertices, turn.apply(before.mesh.vertices.copy()) + shift, atol=1e-5)
    np.testing.assert_allclose(after.pose.joints, before.pose.joints, atol=1e-4)


def test_subjects_have_different_depth_maps(lit: Recording) -> None:
    """The counterpart: what is left after normalising is who it is."""
    maps = [depth_maps(neutral(lit.of_subject(s)).scan, 32) for s in ("s01", "s02")]
    assert (maps[0] - maps[1]).abs().mean() > 0.01
    assert (maps[0][[1, 3]].amax(dim=(1, 2)) > 0.8).all()  # both sides are seen


def test_a_warp_is_smooth_and_keeps_scan_and_joints_together(lit: Recording) -> None:
    person = neutral(lit.of_subject("s01"))
    seen, points = warped(person, 1e-9, np.random.default_rng(0))
    np.testing.assert_allclose(seen.points, person.scan.points, atol=1e-8)
    seen, points = warped(person, 0.05, np.random.default_rng(0))
    moved = np.linalg.norm(points - person.points, axis=1)
    assert 1e-3 < moved.mean() < 2e-2
    near = np.linalg.norm(person.scan.points[:, None] - person.points, axis=2).min(axis=1)
    now = np.linalg.norm(seen.points[:, None] - points, axis=2).min(axis=1)
    assert np.abs(now - near).mean() < 2e-3


def test_the_code_starts_as_principal_components() -> None:
    """With as many components as hands vary in, offsets come back exactly and codes have unit variance."""
    net, rng = model(), np.random.default_rng(4)
    offsets = 2e-3 * np.einsum("nk,kpc->npc", rng.normal(size=(200, 5)), rng.normal(size=(5, 26, 3)))
    net.start(list(HAND.template.points + offsets))
    encoder, decoder = net.identity_encoder, net.identity_decoder
    for layer in (encoder.head.last, decoder.layers.last):
        torch.nn.init.zeros_(layer.weight)
    near = torch.tensor(offsets / _NEAR).float()
    with torch.no_grad():
        code, _ = encoder(torch.zeros(200, 4, 32, 32), near)
        back, vertices = decoder(code)
    np.testing.assert_allclose(back, offsets, atol=1e-6)
    np.testing.assert_allclose(code[:, :5].std(0, unbiased=False), 1.0, atol=1e-3)
    assert not vertices.any()


# -- training ---------------------------------------------------------------------------------------------------


def test_every_network_learns(lit: Recording) -> None:
    net = model(replace(SMALL, warp=0.0))
    lesson = Lesson(net, lit)
    sum(lesson.losses(0, np.random.default_rng(0)).values()).backward()
    for name in ("identity_encoder", "identity_decoder", "pose_encoder", "pose_decoder"):
        gradients = [p.grad for p in getattr(net, name).parameters()]
        assert all(g is not None and g.isfinite().all() for g in gradients), name
        assert sum(g.abs().sum() for g in gradients) > 0, name


def test_it_overfits_one_pose(lit: Recording) -> None:
    one = lit.where(lambda f: f.subject == "s01" and f.pose_name == "pose-0")
    config = replace(SMALL, warp=0.0, scale=(1.0, 1.0), steps=36, rate=(2e-3, 2e-4))
    found = Tracker(config).train(one)
    geometry = found.track(found.identify(one), one)
    truth = one.frames[0].mesh
    start = HAND.mesh(HAND.neutral(), one.frames[0].pose, 1).vertices
    points = point_cloud([(f, one.observe(f)) for f in one.frames]).points
    assert point_error(geometry.mesh.vertices, truth.vertices) < min(2.0, 0.7 * point_error(start, truth.vertices))
    assert surface_distances(geometry.mesh, points).mean() < 0.4


def test_one_seed_one_prior(lit: Recording, prior: GeometryPrior) -> None:
    again, other = Tracker(SMALL).train(lit), Tracker(SMALL).train(lit, seed=1)
    state = prior.model.state_dict()
    assert all(torch.equal(value, state[name]) for name, value in again.model.state_dict().items())
    assert any(not torch.equal(value, state[name]) for name, value in other.model.state_dict().items())


def test_round_trip(lit: Recording, prior: GeometryPrior, tmp_path: Path) -> None:
    prior.save(tmp_path)
    loaded = Tracker(SMALL).load(tmp_path)
    here = lit.of_subject("s02")
    views = here.where(lambda f: f.pose_name == "pose-1")
    one, other = (p.track(p.identify(here), views) for p in (prior, loaded))
    np.testing.assert_array_equal(one.mesh.vertices, other.mesh.vertices)
    with pytest.raises(InputError, match="trained with"):
        Tracker(replace(SMALL, scan=5.0)).load(tmp_path)


# -- tracking ---------------------------------------------------------------------------------------------------


def test_tracked_frames_share_a_mesh_and_keep_their_pictures(
    mini: Capture, lit: Recording, prior: GeometryPrior
) -> None:
    olats = mini.recording(f for f in mini.frames() if f.pose_key == "s01/pose-1" and f.kind == "olat")
    found = Tracking(prior, lit).recording(olats)
    assert len({id(f.mesh) for f in found.frames}) == 1
    frame, before = found.frames[3], olats.frames[3]
    assert (frame.key, type(frame), frame.light) == (before.key, Frame, before.light)
    assert frame.mesh.topology is before.mesh.topology and frame.mesh is not before.mesh
    np.testing.assert_array_equal(found.observe(frame).image, olats.observe(before).image)
    again = Tracking(prior, lit).of(before.viewpoint)
    np.testing.assert_array_equal(again.mesh.vertices, frame.mesh.vertices)
    # pose and mesh belong together: the tracked pose puts the wrist where the mesh has it
    assert np.abs(frame.pose.joints - before.pose.joints).max() < np.radians(25)


def test_the_report_knows_its_baselines(mini: Capture, lit: Recording, prior: GeometryPrior) -> None:
    held_out = mini.recording(f for f in mini.frames() if f.kind == "full" and f.segment == "held-out")
    found = {(e.frame, e.row): e for e in geometry_report(prior, lit, held_out)}
    assert len(found) == 3 * len(held_out.frames)
    for frame in held_out.frames:
        own, template, floor = (found[frame.key, row] for row in ("autoencoder", "template", "tracked"))
        assert floor.surface_mean < 0.25 < template.surface_mean and floor.vertex is None and floor.joint is None
        assert own.joint > 0.0 and own.surface_mean < own.surface_p95
        truth = point_error(HAND.mesh(HAND.neutral(), frame.pose, 1).vertices, frame.mesh.vertices)
        assert template.vertex == pytest.approx(truth)


def test_the_study_writes_what_it_returns(tmp_path: Path) -> None:
    result = run("smoke", tmp_path, preset="smoke")
    assert json.loads((tmp_path / "geometry.json").read_text()) == json.loads(json.dumps(result))
    assert [(line["group"], line["row"]) for line in result["table"]] == [
        (group, row) for group in ("trained", "unseen") for row in ("autoencoder", "template", "tracked")
    ]
    assert result["table"][0]["surface_mean"] < result["table"][1]["surface_mean"]
    create("smoke").load(tmp_path / "prior")


# -- refusals ---------------------------------------------------------------------------------------------------


def without_depth(recording: Recording) -> Recording:
    def observe(frame: Frame) -> Observation:
        seen = recording.observe(frame)
        return Observation(seen.image, seen.alpha)

    return Recording(recording.frames, observe)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda r: r.of_kind("olat"), "fully lit frames"),
        (without_depth, "no depth channel"),
        (lambda r: r.where(lambda f: f.pose_name == "pose-1"), "neutral pose"),
    ],
)
def test_recordings_that_cannot_be_learned_from(
    lit: Recording, change: Callable[[Recording], Recording], reason: str
) -> None:
    with pytest.raises(Unsupported, match=reason):
        Tracker(SMALL).train(change(lit))


def test_a_pose_without_a_fully_lit_frame(mini: Capture, lit: Recording, prior: GeometryPrior) -> None:
    frame = next(f for f in mini.frames() if f.segment == "held-out")
    with pytest.raises(Unsupported, match=f"{frame.pose_key} cannot be tracked"):
        Tracking(prior, lit).of(frame)


def test_another_hand_model(lit: Recording) -> None:
    frame = lit.frames[0]
    topology = replace(frame.mesh.topology, faces=frame.mesh.topology.faces[:, ::-1])
    strange = lit.where(lambda f: f is frame)
    strange.frames = (replace(frame, mesh=Mesh(frame.mesh.vertices, topology)),)
    with pytest.raises(Unsupported, match="of none of the hand models"):
        Tracker(SMALL).train(strange)


def test_settings_that_make_no_sense() -> None:
    for bad in ({"image": 100}, {"code": 0}, {"scale": (0.0, 1.0)}, {"warp": -1.0}):
        with pytest.raises(InputError, match=f"geometry: {next(iter(bad))}"):
            GeometryConfig(**bad)
    with pytest.raises(InputError, match="did you mean 'quick'"):
        create("quik")


def test_a_prior_of_a_version_that_did_not_tell_its_hand_is_one_sentence(tmp_path: Path) -> None:
    model = GeometryModel(SMALL, HAND, 1)
    for lost in ({"level": torch.tensor(1)}, {"hand": torch.tensor([*b"openhand"], dtype=torch.uint8)}):
        save_state(tmp_path, "geometry", asdict(model.config), {**model.state_dict(), **lost})
        with pytest.raises(InputError, match="are of another version of geometry; train again"):
            Tracker(SMALL).load(tmp_path)
