"""Two surfaces compared: distances of points spread over each from the nearest point of the other.

Points are spread evenly by area, `POINTS` of them with a seed, and are measured to triangles, not to other points:
the same surface has distance zero however it is sampled or triangulated. Triangles without area are left out.

surface-mean, surface-p95   of points of the truth from the prediction, as a scan is compared with a model
chamfer                     the mean of the two mean distances, not squared
hausdorff                   the greatest distance either way, of the points and of the corners of all triangles
fscore                      F-score of Knapitsch et al., "Tanks and Temples", 2017: the harmonic mean of the shares of
                            each surface that lie within a threshold of the other
mesh-normal                 mean angle between the normals at points and at the nearest points, mean of both ways: the
                            normal consistency of Mescheder et al., "Occupancy Networks", 2019, as an angle and with
                            its sign, so that a surface inside out is 180 degrees off. Normals are smooth: the nearest
                            point is often on an edge, where a face's own would be a matter of chance. Vertices at one
                            place share one normal, so that seams and other cuts of a file's vertices count for nothing
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from handbench.errors import HandbenchError, InputError, Unsupported
from handbench.lean import open3d
from handbench.render.uv.surface import vertex_normals
from handbench.scene import Array, Mesh

from ..base import PairFamily
from ..view import Looks
from .angles import angles
from .units import same_unit

POINTS, SEED = 20_000, 0
_MM = 1000.0
_FAR = 1e6
_WELD = 1e-6  # of the greatest side of a mesh: what single precision may part


class Surface:
    """The triangles of a mesh that have an area: vertices (V, 3), faces (F, 3) with F > 0.

    Raises `InputError` if there are none, and for a mesh that reaches further than single precision can compare.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.vertices, faces = mesh.vertices, mesh.topology.faces
        reach = float(np.abs(self.vertices).max(initial=0.0))
        if reach > _FAR:
            raise InputError(
                f"mesh: it reaches {reach:.3g} m from the origin, farther than {_FAR:g} m; lengths are metres"
            )
        a, b, c = (self.vertices[faces[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
        if not (area > 0).any():
            raise InputError(f"mesh: none of its {len(faces)} faces has an area; give a mesh with a surface")
        self.faces, self._area = faces[area > 0], area[area > 0]

    def at(self, face: Array, u: Array, v: Array) -> tuple[Array, Array]:
        """Points (N, 3) and smooth normals (N, 3), of any length, at barycentric u and v (N,) of faces (N,)."""
        weights, corners = np.stack([1.0 - u - v, u, v], axis=1)[..., None], self.faces[face]
        return (weights * self.vertices[corners]).sum(axis=1), (weights * self._normals[corners]).sum(axis=1)

    @cached_property
    def _normals(self) -> Array:
        place = welded(self.vertices)
        return vertex_normals(self.vertices, place[self.faces])[place]

    @cached_property
    def corners(self) -> Array:
        """The vertices (C, 3) that the faces use."""
        return self.vertices[np.unique(self.faces)]

    def sample(self, count: int = POINTS, seed: int = SEED) -> tuple[Array, Array, Array]:
        """Face, u and v (count,) of points for `at`, one in each of `count` equal shares of the area."""
        rng = np.random.default_rng(seed)
        reached = np.cumsum(self._area)
        at = (np.arange(count) + rng.random(count)) * (reached[-1] / count)
        face = np.minimum(np.searchsorted(reached, at, side="right"), len(reached) - 1)
        u, v = rng.random((2, count))
        u, v = np.where(u + v > 1.0, (1.0 - u, 1.0 - v), (u, v))  # the other half of the parallelogram
        return face, u, v

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Distance (N,) in mm of points (N, 3) from the surface, and its normals (N, 3) where they are nearest."""
        scene, tensor, middle = self._embree
        found = scene.compute_closest_points(tensor((points - middle).astype(np.float32)))
        distance = _MM * np.linalg.norm(points - middle - found["points"].numpy(), axis=1)
        face, (u, v) = found["primitive_ids"].numpy().astype(np.int64), found["primitive_uvs"].numpy().T
        return distance, self.at(face, u, v)[1]

    @cached_property
    def _embree(self) -> tuple[Any, Any, Array]:
        """What answers, how it is asked, and the middle that it works around, in float32."""
        o3d = open3d()
        scene, tensor, middle = o3d.t.geometry.RaycastingScene(), o3d.core.Tensor.from_numpy, self.corners.mean(axis=0)
        scene.add_triangles(tensor((self.vertices - middle).astype(np.float32)), tensor(self.faces.astype(np.uint32)))
        return scene, tensor, middle


def welded(vertices: Array) -> Array:
    """For each of vertices (V, 3) the first one at the same place, (V,): within a millionth of their greatest extent.

    Meshes in files are cut where their texture is, or have corners of their own for each face.
    """
    near = cKDTree(vertices).query_pairs(_WELD * float(np.ptp(vertices, axis=0).max()), output_type="ndarray")
    count = len(vertices)
    links = coo_array((np.ones(len(near), np.int8), (near[:, 0], near[:, 1])), (count, count))
    _, group = connected_components(links, directed=False)
    return np.unique(group, return_index=True)[1][group]


@dataclass(frozen=True, eq=False)
class Gaps:
    """From one surface to another: distances in mm of `POINTS` points spread over it and of its corners (C,), and
    angles in degrees between the normals at the points and at the nearest points."""

    points: Array
    corners: Array
    angles: Array


def gaps(source: Surface, target: Surface) -> Gaps:
    """From one surface to another."""
    points, normals = source.at(*source.sample())
    distances, nearest = target.nearest(points)
    return Gaps(distances, target.nearest(source.corners)[0], angles(normals, nearest))


class Facing:
    """A prediction and its truth as surfaces; the gaps between them are worked out when they are asked for, and kept.

    Raises `Unsupported` for a prediction without a surface or in millimetres, and `InputError` for a truth without a
    surface: a damaged capture.
    """

    def __init__(self, prediction: Mesh, truth: Mesh) -> None:
        self.truth = self._surface("truth", truth, InputError)
        self.prediction = self._surface("prediction", prediction, Unsupported)
        spans = (float(np.ptp(each.corners, axis=0).max()) for each in (self.prediction, self.truth))
        same_unit("the mesh spans", *spans)

    @staticmethod
    def _surface(whose: str, mesh: Mesh, refusal: type[HandbenchError]) -> Surface:
        try:
            return Surface(mesh)
        except InputError as error:
            raise refusal(f"{whose} {error}") from error

    @cached_property
    def from_prediction(self) -> Gaps:
        return gaps(self.prediction, self.truth)

    @cached_property
    def from_truth(self) -> Gaps:
        return gaps(self.truth, self.prediction)


def surface_distances(mesh: Mesh, points: Array) -> Array:
    """Distance (N,) in mm of each point (N, 3) of a scan from the nearest point of the mesh.

    Raises `InputError` for points of another shape, none, or NaN among them, and for a mesh without a surface.
    """
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise InputError(f"surface_distances: points have shape {points.shape}, expected (n, 3) with n > 0")
    if not np.isfinite(points).all():
        raise InputError("surface_distances: points hold NaN or infinity; remove them first")
    return Surface(mesh).nearest(points)[0]


def mean(distances: Array) -> float:
    return float(distances.mean())


def percentile95(distances: Array) -> float:
    return float(np.percentile(distances, 95))


def fscore(precise: Array, complete: Array, threshold: float) -> float:
    """F-score in [0, 1] from the distances of the prediction from the truth and of the truth from the prediction."""
    precision, recall = (float((distances < threshold).mean()) for distances in (precise, complete))
    return 2.0 * precision * recall / (precision + recall) if precision + recall else 0.0


@dataclass(frozen=True)
class SurfaceFamily(PairFamily):
    """A way of measuring two surfaces. Frames of one pose have the same ones, so the looks keep the last of them."""

    def seen(self, looks: Looks) -> Facing:
        prediction, truth = looks.pair.prediction_mesh, looks.pair.truth_mesh
        assert prediction is not None and truth is not None  # `needs` names them
        key = "surfaces", *map(_digest, (prediction, truth))
        return looks.recent(key, lambda: Facing(prediction, truth))


def _digest(mesh: Mesh) -> str:
    """What tells meshes apart: captures may read each frame's anew."""
    return mesh.topology.digest + hashlib.blake2b(np.ascontiguousarray(mesh.vertices).data, digest_size=16).hexdigest()


def _mean(facing: Facing, options: Mapping[str, str]) -> float:
    return mean(facing.from_truth.points)


def _percentile(facing: Facing, options: Mapping[str, str]) -> float:
    return percentile95(facing.from_truth.points)


def _hausdorff(facing: Facing, options: Mapping[str, str]) -> float:
    return float(max(distances.max() for way in _both(facing) for distances in (way.points, way.corners)))


def _chamfer(facing: Facing, options: Mapping[str, str]) -> float:
    return sum(mean(way.points) for way in _both(facing)) / 2


def _fscore(facing: Facing, options: Mapping[str, str]) -> float:
    precise, complete = _both(facing)
    return fscore(precise.points, complete.points, float(options["threshold"].removesuffix("mm")))


def _normal(facing: Facing, options: Mapping[str, str]) -> float:
    return sum(mean(way.angles) for way in _both(facing)) / 2


def _both(facing: Facing) -> tuple[Gaps, Gaps]:
    return facing.from_prediction, facing.from_truth


def _family(name: str, title: str, measure: Any, *terms: str, **others: Any) -> SurfaceFamily:
    """Errors in mm unless said otherwise, with what all of them share."""
    shared = {"higher_is_better": False, "unit": "mm", "decimals": 2, "perfect": 0.0}
    terms = ("align:none", *terms, f"points:{POINTS}", f"seed:{SEED}")
    needs = ("prediction_mesh", "truth_mesh")
    return SurfaceFamily(name=name, title=title, measure=measure, terms=terms, needs=needs, **{**shared, **others})


MEAN = _family("surface-mean", "Surface mean", _mean, "from:truth")
P95 = _family("surface-p95", "Surface p95", _percentile, "from:truth")
HAUSDORFF = _family("hausdorff", "Hausdorff", _hausdorff, "from:both", "corners:all")
CHAMFER = _family("chamfer", "Chamfer", _chamfer, "from:both", "power:1", "of-both:mean")
FSCORE = _family(
    "fscore",
    "F-score",
    _fscore,
    "from:both",
    unit="",
    decimals=3,
    higher_is_better=True,
    perfect=1.0,
    choices={"threshold": ("2mm", "1mm", "5mm")},
)
NORMAL = _family(
    "mesh-normal", "Mesh normals", _normal, "from:both", "normals:smooth", "welded:by-place", unit="deg", version=2
)
