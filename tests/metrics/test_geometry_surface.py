"""Distances of surfaces against closed forms, pymeshlab and open3d's own metrics."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache

import numpy as np
import pymeshlab
import pytest
from scipy.spatial.transform import Rotation

from handbench.errors import InputError
from handbench.hand.openhand import OpenHand
from handbench.lean import open3d
from handbench.metrics import Pair, Recent, Score, metric, scores
from handbench.metrics.geometry.surface import POINTS, Surface, gaps, surface_distances
from handbench.scene import Array, Mesh, Pose, Topology

SPECS = ("surface-mean", "surface-p95", "hausdorff", "chamfer", "fscore", "mesh-normal")
PICTURE, MASK = np.zeros((1, 1, 3)), np.ones((1, 1))
HAND = OpenHand.load()


def mesh(vertices: Array, faces: Array) -> Mesh:
    return Mesh(vertices, Topology(faces, np.zeros((1, 2)), np.zeros_like(faces)))


def sphere(radius: float, resolution: int = 60) -> Mesh:
    made = open3d().geometry.TriangleMesh.create_sphere(radius, resolution)
    return mesh(np.asarray(made.vertices), np.asarray(made.triangles))


def plane(side: float = 0.1, cells: int = 7) -> Mesh:
    """A square in z = 0 around the origin that faces +z."""
    at = np.linspace(-side / 2, side / 2, cells + 1)
    x, y = np.meshgrid(at, at)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    a, b, c, d = corner, corner + 1, corner + cells + 2, corner + cells + 1
    return mesh(
        np.column_stack([x.ravel(), y.ravel(), 0.0 * x.ravel()]),
        np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])]),
    )


def moved(one: Mesh, turn: Rotation, shift: Array) -> Mesh:
    return Mesh(turn.apply(one.vertices.copy()) + shift, one.topology)


@cache
def hands() -> tuple[Mesh, Mesh]:
    """A neutral hand, and another identity in a bent pose two millimetres beside: 2,764 faces each."""
    rng = np.random.default_rng(0)
    straight = HAND.mesh(HAND.neutral(), Pose(np.zeros((21, 3))), 0)
    bent = HAND.mesh(HAND.sample_identity(rng), Pose(rng.normal(0, 0.06, (21, 3)), translation=[0.002, 0, 0]), 0)
    return bent, straight


def points_of(one: Mesh, count: int, seed: int) -> Array:
    surface = Surface(one)
    return surface.at(*surface.sample(count, seed))[0]


ALL = (*SPECS, *(f"fscore:threshold={mm}mm" for mm in (1, 2, 5)))


@lru_cache(maxsize=2)
def _all(prediction: Mesh | None, truth: Mesh | None) -> dict[str, Score]:
    """Every score of a pair: together they look for the nearest points once."""
    pair = Pair(PICTURE, PICTURE, MASK, prediction_mesh=prediction, truth_mesh=truth)
    return dict(zip(ALL, scores([metric(spec) for spec in ALL], [pair])[0], strict=True))


def score(spec: str, prediction: Mesh | None, truth: Mesh | None) -> float:
    found = _all(prediction, truth)[spec]
    assert found.value is not None, found.reason
    return found.value


# -- closed forms -----------------------------------------------------------------------------------------------


def test_concentric_spheres() -> None:
    large, small = sphere(0.053), sphere(0.050)
    for spec in ("surface-mean", "surface-p95", "hausdorff", "chamfer"):
        assert score(spec, large, small) == pytest.approx(3.0, abs=0.05), spec  # facets lie 0.04 mm inside a sphere
    assert score("fscore:threshold=1mm", large, small) == score("fscore", large, small) == 0.0
    assert score("fscore:threshold=5mm", large, small) == 1.0
    assert score("mesh-normal", large, small) < 0.1
    inside_out = mesh(large.vertices, large.topology.faces[:, ::-1])
    assert score("mesh-normal", inside_out, small) > 179.9


def test_a_lifted_plane_is_as_far_everywhere() -> None:
    truth, lifted = plane(), moved(plane(), Rotation.identity(), np.array([0.0, 0.0, 1.5e-3]))
    for spec in ("surface-mean", "surface-p95", "hausdorff", "chamfer"):
        assert score(spec, lifted, truth) == pytest.approx(1.5, abs=1e-5), spec
    thresholds = [score(f"fscore:threshold={mm}mm", lifted, truth) for mm in (1, 2, 5)]
    assert thresholds == [0.0, 1.0, 1.0]
    assert score("mesh-normal", lifted, truth) == 0.0


def test_a_tilted_plane_is_as_far_as_trigonometry_says() -> None:
    side, angle = 0.1, np.radians(10.0)
    truth, tilted = plane(side), moved(plane(side), Rotation.from_rotvec([0.0, angle, 0.0]), np.zeros(3))
    far = 1e3 * side / 2 * np.sin(angle)
    assert score("surface-mean", tilted, truth) == pytest.approx(far / 2, rel=1e-3)
    assert score("surface-p95", tilted, truth) == pytest.approx(0.95 * far, rel=1e-3)
    assert score("hausdorff", tilted, truth) == pytest.approx(far, rel=1e-5)  # at the corners, which no sample hits
    assert score("mesh-normal", tilted, truth) == pytest.approx(10.0, abs=1e-6)


def test_fscore_is_the_harmonic_mean_of_both_shares() -> None:
    """The left half, and thrice as much again 10 mm and more above it: precision 1/4, recall 1/2 and the threshold."""
    truth = plane(0.1, 8)
    left = truth.topology.faces[truth.vertices[truth.topology.faces, 0].mean(axis=1) < 0.0]
    sheets, count = range(4), len(truth.vertices)
    half = mesh(
        np.concatenate([truth.vertices + np.array([0.0, 0.0, 0.01 * sheet]) for sheet in sheets]),
        np.concatenate([left + count * sheet for sheet in sheets]),
    )
    precision, recall = 0.25, (50.0 + 2.0) / 100.0
    assert score("fscore", half, truth) == pytest.approx(2 * precision * recall / (precision + recall), abs=1e-3)
    assert score("surface-mean", half, truth) != pytest.approx(score("surface-mean", truth, half), abs=0.1)


# -- other people's programs ------------------------------------------------------------------------------------


def meshlab_distance(source: Mesh, target: Mesh, **sampling: object) -> dict[str, float]:
    both = pymeshlab.MeshSet()
    for one in (source, target):
        both.add_mesh(pymeshlab.Mesh(one.vertices, one.topology.faces))
    unbounded = pymeshlab.PureValue(1.0)
    return both.get_hausdorff_distance(sampledmesh=0, targetmesh=1, maxdist=unbounded, **sampling)


def test_distances_at_the_vertices_are_pymeshlabs() -> None:
    prediction, truth = hands()
    theirs = meshlab_distance(truth, prediction, samplevert=True, sampleface=False)
    ours = surface_distances(prediction, truth.vertices)
    assert theirs["n_samples"] == len(ours)
    assert 1e3 * theirs["mean"] == pytest.approx(ours.mean(), abs=1e-3)
    assert 1e3 * theirs["max"] == pytest.approx(ours.max(), abs=1e-3)
    assert 1e3 * theirs["RMS"] == pytest.approx(np.sqrt((ours**2).mean()), abs=1e-3)


def test_distances_over_the_surface_are_pymeshlabs() -> None:
    prediction, truth = hands()
    sampling = {"samplevert": False, "sampleface": True, "samplenum": 40_000}
    there = meshlab_distance(truth, prediction, **sampling)
    back = meshlab_distance(prediction, truth, **sampling)
    assert score("surface-mean", prediction, truth) == pytest.approx(1e3 * there["mean"], rel=0.01)
    assert score("chamfer", prediction, truth) == pytest.approx(500 * (there["mean"] + back["mean"]), rel=0.01)
    assert score("hausdorff", prediction, truth) == pytest.approx(1e3 * max(there["max"], back["max"]), rel=0.01)


def test_scores_are_open3ds() -> None:
    """Its chamfer is the sum of both means; its F-score is a percentage; its distances are to sampled points."""
    prediction, truth = hands()
    of = open3d().t.geometry.TriangleMesh
    one, other = (
        of(open3d().core.Tensor(m.vertices.astype(np.float32)), open3d().core.Tensor(m.topology.faces.astype(np.int32)))
        for m in (prediction, truth)
    )
    kinds = open3d().t.geometry.Metric
    parameters = open3d().t.geometry.MetricParameters(fscore_radius=[0.001, 0.002, 0.005], n_sampled_points=100_000)
    wanted = [kinds.ChamferDistance, kinds.HausdorffDistance, kinds.FScore]
    chamfer, hausdorff, *shares = one.compute_metrics(other, wanted, parameters).numpy()
    assert score("chamfer", prediction, truth) == pytest.approx(500 * chamfer, rel=0.02)
    assert score("hausdorff", prediction, truth) == pytest.approx(1e3 * hausdorff, rel=0.02)
    for threshold, share in zip((1, 2, 5), shares, strict=True):
        assert score(f"fscore:threshold={threshold}mm", prediction, truth) == pytest.approx(share / 100, abs=0.01)


def test_distances_are_those_of_a_dense_cloud() -> None:
    prediction, truth = hands()
    points, dense = points_of(truth, 500, 3), points_of(prediction, 400_000, 0)
    clouds = [open3d().geometry.PointCloud(open3d().utility.Vector3dVector(p)) for p in (points, dense)]
    to_points = 1e3 * np.asarray(clouds[0].compute_point_cloud_distance(clouds[1]))
    to_surface = surface_distances(prediction, points)
    assert (to_surface <= to_points + 1e-4).all()
    assert np.abs(to_surface - to_points).mean() < 0.02


# -- sampling ---------------------------------------------------------------------------------------------------


def test_samples_are_even_on_the_surface_and_repeat() -> None:
    surface = Surface(hands()[0])
    face, u, v = surface.sample(5000, seed=7)
    points, _ = surface.at(face, u, v)
    assert np.array_equal(points, surface.at(*surface.sample(5000, seed=7))[0])
    assert not np.array_equal(points, surface.at(*surface.sample(5000, seed=8))[0])
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    share = 5000 * area / area.sum()
    assert np.abs(np.bincount(face, minlength=len(area)) - share).max() < 2.0  # one in each equal share of the area
    assert surface.nearest(points)[0].max() < 1e-4
    corners = np.stack([a, b, c], axis=1)[face]
    inside = [np.linalg.lstsq(t.T, p, rcond=None)[0] for t, p in zip(corners[:200], points[:200], strict=True)]
    assert np.min(inside) > -1e-9
    middle = (corners.mean(axis=1) - points).mean(axis=0)
    assert np.abs(middle).max() < 1e-4  # even within the triangles as well


def test_the_triangulation_does_not_matter() -> None:
    prediction, truth = hands()
    made = (
        open3d()
        .geometry.TriangleMesh(
            open3d().utility.Vector3dVector(prediction.vertices.copy()),
            open3d().utility.Vector3iVector(prediction.topology.faces.copy()),
        )
        .subdivide_midpoint(1)
    )
    finer = mesh(np.asarray(made.vertices), np.asarray(made.triangles))
    for spec in ("surface-mean", "surface-p95", "hausdorff", "chamfer", "fscore"):
        assert score(spec, finer, truth) == pytest.approx(score(spec, prediction, truth), rel=0.01), spec


def test_more_points_change_little() -> None:
    prediction, truth = hands()
    many = surface_distances(prediction, points_of(truth, 5 * POINTS, 1))
    few = gaps(Surface(truth), Surface(prediction)).points
    assert few.mean() == pytest.approx(many.mean(), rel=2e-3)
    assert np.percentile(few, 95) == pytest.approx(np.percentile(many, 95), rel=5e-3)


def test_frames_of_one_pose_share_their_surfaces_whoever_read_the_meshes(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Mesh] = []
    honest = Surface.__init__
    monkeypatch.setattr(Surface, "__init__", lambda self, one: made.append(one) or honest(self, one))
    bent, straight = hands()
    other = moved(bent, Rotation.identity(), np.array([0.0, 0.0, 1e-3]))

    def pair(prediction: Mesh, truth: Mesh) -> Pair:
        read = (Mesh(each.vertices.copy(), each.topology) for each in (prediction, truth))
        return Pair(PICTURE, PICTURE, MASK, **dict(zip(("prediction_mesh", "truth_mesh"), read, strict=True)))

    asked = [metric(spec) for spec in SPECS]
    pairs = [(bent, straight), (bent, straight), (other, straight), (bent, other), (bent, straight)]
    recent = Recent()
    rows = scores(asked, (pair(*each) for each in pairs[:2]), recent)
    rows += scores(asked, (pair(*each) for each in pairs[2:]), recent)
    assert len(made) == 2 * 3
    assert rows == [scores(asked, [pair(*each)])[0] for each in pairs]
    made.clear()
    scores(asked, [pair(bent, straight)])
    assert len(made) == 2, "nothing outlives who asked"


def seeds_apart(prediction: Mesh, truth: Mesh) -> float:
    """How far the mean distance of the truth's points differs between ten seeds, as a share of it."""
    means = [surface_distances(prediction, points_of(truth, POINTS, seed)).mean() for seed in range(10)]
    return float(np.ptp(means) / np.mean(means))


def test_another_seed_changes_a_mean_as_much_as_the_documentation_says() -> None:
    prediction, truth = hands()
    rough = Mesh(truth.vertices + np.random.default_rng(0).normal(0, 3e-4, truth.vertices.shape), truth.topology)
    vertices = truth.vertices.copy()
    tip = vertices[np.argmax(vertices[:, 1])]
    vertices[np.linalg.norm(vertices - tip, axis=1) < 0.01] += np.array([0.0, 0.005, 0.0])
    assert seeds_apart(prediction, truth) < 0.01
    assert 0.002 < seeds_apart(rough, truth) < 0.02
    assert 0.05 < seeds_apart(Mesh(vertices, truth.topology), truth) < 0.25


# -- seams ------------------------------------------------------------------------------------------------------


def cut_at_texture_seams(one: Mesh) -> Mesh:
    """As OBJ files are loaded: one vertex for each pair of a position and a texture coordinate."""
    faces, uv = one.topology.faces, one.topology.uv_faces
    pairs, index = np.unique(np.stack([faces.ravel(), uv.ravel()], axis=1), axis=0, return_inverse=True)
    assert len(pairs) > len(one.vertices) + 50
    return mesh(one.vertices[pairs[:, 0]], index.reshape(faces.shape))


def unwelded(one: Mesh) -> Mesh:
    """As STL files are: every face with corners of its own."""
    return mesh(one.vertices[one.topology.faces].reshape(-1, 3), np.arange(one.topology.faces.size).reshape(-1, 3))


def twice(one: Mesh) -> Mesh:
    """All vertices a second time, used by every second face."""
    faces = one.topology.faces.copy()
    faces[::2] += len(one.vertices)
    return mesh(np.concatenate([one.vertices, one.vertices]), faces)


def rounded(one: Mesh) -> Mesh:
    """Corners of one place, each off by what single precision may lose."""
    apart = unwelded(one)
    off = np.random.default_rng(5).uniform(-2e-8, 2e-8, apart.vertices.shape)
    return Mesh(apart.vertices + off, apart.topology)


@pytest.mark.parametrize("cut", [cut_at_texture_seams, unwelded, twice, rounded])
def test_how_a_file_shares_vertices_is_no_error_of_normals(cut: Callable[[Mesh], Mesh]) -> None:
    prediction, truth = hands()
    assert score("mesh-normal", cut(truth), truth) == pytest.approx(0.0, abs=0.02)
    assert score("mesh-normal", cut(prediction), truth) == pytest.approx(score("mesh-normal", prediction, truth), 1e-4)
    assert score("mesh-normal", prediction, cut(truth)) == pytest.approx(score("mesh-normal", prediction, truth), 1e-4)


def test_noise_is_an_error_of_normals_however_vertices_are_shared() -> None:
    truth = hands()[1]
    rough = Mesh(truth.vertices + np.random.default_rng(0).normal(0, 5e-4, truth.vertices.shape), truth.topology)
    found = score("mesh-normal", rough, truth)
    assert 3.0 < found < 4.5
    assert score("mesh-normal", unwelded(rough), truth) == pytest.approx(found, rel=1e-4)


def test_surfaces_that_are_near_are_not_welded() -> None:
    """Two sheets 0.1 mm apart that face away from each other keep their normals."""
    up, below = plane(), moved(plane(), Rotation.identity(), np.array([0.0, 0.0, -1e-4]))
    faces, count = up.topology.faces, len(up.vertices)
    slab = mesh(np.concatenate([up.vertices, below.vertices]), np.concatenate([faces, faces[:, ::-1] + count]))
    assert score("mesh-normal", Mesh(slab.vertices, slab.topology), slab) < 0.1


# -- laws -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spec", SPECS)
def test_the_same_surface_is_perfect(spec: str) -> None:
    truth = hands()[1]
    again = Mesh(truth.vertices, truth.topology)
    assert score(spec, again, truth) == pytest.approx(metric(spec).perfect, abs=5e-3)


def test_distances_of_the_same_surface_are_rounding() -> None:
    truth = hands()[1]
    assert score("hausdorff", Mesh(truth.vertices, truth.topology), truth) < 1e-4


def test_a_rigid_motion_of_both_changes_nothing() -> None:
    """Ten metres away: distances are worked out around the middle of the mesh, where float32 suffices."""
    turn, shift = Rotation.from_rotvec([0.4, -1.0, 2.0]), np.array([10.0, -3.0, 5.0])
    there = [moved(one, turn, shift) for one in hands()]
    for spec in SPECS:
        assert score(spec, *there) == pytest.approx(score(spec, *hands()), rel=1e-4), spec


@pytest.mark.parametrize("spec", ["hausdorff", "chamfer", "fscore", "mesh-normal"])
def test_what_looks_both_ways_is_symmetric(spec: str) -> None:
    prediction, truth = hands()
    assert score(spec, prediction, truth) == pytest.approx(score(spec, truth, prediction), rel=1e-9)


def test_signatures_say_what_decides_the_value() -> None:
    assert metric("chamfer").signature == "chamfer|align:none|from:both|power:1|of-both:mean|points:20000|seed:0|v1"
    assert metric("fscore:threshold=5mm").signature.startswith("fscore|threshold:5mm|align:none|from:both|")
    assert metric("mesh-normal").signature.endswith("|normals:smooth|welded:by-place|points:20000|seed:0|v2")
    assert metric("surface-mean").signature != metric("surface-p95").signature
    assert metric("hausdorff").latex == r"Hausdorff$\downarrow$" and metric("fscore").latex == r"F-score$\uparrow$"
    assert (metric("chamfer").unit, metric("mesh-normal").unit, metric("fscore").unit) == ("mm", "deg", "")


# -- refusals ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spec", SPECS)
def test_a_prediction_without_a_surface_has_a_reason(spec: str) -> None:
    truth = hands()[1]
    empty = mesh(truth.vertices, np.zeros((0, 3), int))
    needle = mesh(truth.vertices, np.zeros((5, 3), int))
    pairs = [Pair(PICTURE, PICTURE, MASK, prediction_mesh=m, truth_mesh=truth) for m in (empty, needle, None)]
    reasons = [found.reason for found in metric(spec)(pairs)]
    assert reasons == [
        "prediction mesh: none of its 0 faces has an area; give a mesh with a surface",
        "prediction mesh: none of its 5 faces has an area; give a mesh with a surface",
        "the method gives no mesh",
    ]
    with pytest.raises(InputError, match="truth mesh: none of its 5 faces"):
        score(spec, truth, needle)
    (missing,) = metric(spec)([Pair(PICTURE, PICTURE, MASK, prediction_mesh=truth)])
    assert missing.reason == "the capture gives no mesh"


def test_triangles_without_area_and_loose_vertices_count_for_nothing() -> None:
    prediction, truth = hands()
    vertices, loose = np.concatenate([prediction.vertices, [[5.0, 5.0, 5.0]]]), len(prediction.vertices)
    dirty = mesh(vertices, np.concatenate([prediction.topology.faces, [[0, 0, 1], [loose, loose, loose]]]))
    for spec in SPECS:
        assert score(spec, dirty, truth) == pytest.approx(score(spec, prediction, truth), rel=1e-3), spec


def test_a_surface_without_a_side_has_no_normals() -> None:
    square = plane()
    faces = square.topology.faces
    sheet = mesh(square.vertices, np.concatenate([faces, faces[:, ::-1]]))
    (found,) = metric("mesh-normal")([Pair(PICTURE, PICTURE, MASK, prediction_mesh=sheet, truth_mesh=square)])
    assert found.reason == "Mesh normals is nan"
    assert score("chamfer", sheet, square) < 1e-4


def test_vertices_that_are_not_finite_make_no_mesh() -> None:
    truth = plane()
    with pytest.raises(InputError, match="3 values that are NaN"):
        Mesh(np.where(np.arange(len(truth.vertices))[:, None] == 4, np.nan, truth.vertices), truth.topology)


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("size", [1e8, 1e25, 1e200])
def test_a_mesh_that_exploded_has_a_reason(spec: str, size: float) -> None:
    truth = hands()[1]
    exploded = Mesh(truth.vertices * size, truth.topology)
    (found,) = metric(spec)([Pair(PICTURE, PICTURE, MASK, prediction_mesh=exploded, truth_mesh=truth)])
    assert found.reason is not None and found.reason.startswith("prediction mesh: it reaches ")


@pytest.mark.parametrize("spec", SPECS)
def test_a_mesh_in_millimetres_is_named(spec: str) -> None:
    prediction, truth = hands()
    for pair, whose in (((1e3, 1.0), "prediction"), ((1.0, 1e3), "truth")):
        found, true = (
            Mesh(one.vertices * size, one.topology) for one, size in zip((prediction, truth), pair, strict=True)
        )
        (score,) = metric(spec)([Pair(PICTURE, PICTURE, MASK, prediction_mesh=found, truth_mesh=true)])
        assert score.value is None and f"the {whose} seems to be in millimetres; give metres" in score.reason


def test_points_that_are_no_scan() -> None:
    with pytest.raises(InputError, match="NaN or infinity"):
        surface_distances(plane(), np.full((2, 3), np.nan))
    for points in (np.zeros((0, 3)), np.zeros((4, 2)), np.zeros(3)):
        with pytest.raises(InputError, match=r"expected \(n, 3\)"):
            surface_distances(plane(), points)
