"""Fitting the open hand to pictures of itself: errors against the truth, and time, at realistic noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_closing, binary_opening, gaussian_filter
from scipy.spatial.transform import Rotation

from handbench.hand import HandModel, hand_model
from handbench.hand.fitting import Fit, Picture
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import rasterise
from handbench.scene import Array, Camera, Mesh, Pose

LEVEL = 2  # of the surface that is photographed; fits see coarser ones


@dataclass(frozen=True)
class Noise:
    """What a detector, a matting network and a phone's depth sensor get wrong.

    key_points: pixels, standard deviation; outliers: share of key points that are `astray` times as far off;
    ragged: pixels by which the mask's outline wanders; depth: metres, standard deviation, grown by the depth's edges;
    holes: share of depth pixels without a value.
    """

    key_points: float = 1.5
    outliers: float = 0.08
    astray: float = 8.0
    ragged: float = 1.2
    depth: float = 0.003
    holes: float = 0.1


@dataclass(frozen=True, eq=False)
class Sitter:
    """A true hand in front of a camera."""

    hand: HandModel
    shape: Array
    pose: Pose
    camera: Camera
    noise: Noise

    @property
    def vertices(self) -> Array:
        """True coarse vertices (V, 3) in the world."""
        return self.hand.posed(self.shape, self.pose)[0]

    def picture(self, rng: np.random.Generator, depth: bool, name: str = "picture") -> Picture:
        """Noisy key points and mask, and with `depth` noisy depth."""
        noise, camera = self.noise, self.camera
        mesh = self.hand.mesh(self.shape, self.pose, min(LEVEL, self.hand.levels))
        raster = rasterise(PosedMesh(Mesh(mesh.vertices, mesh.topology)), camera, 2)
        _, points = self.hand.posed(self.shape, self.pose)
        places, _ = camera.project(points[list(self.hand.key_points)])
        far = rng.random(21) < noise.outliers
        places = places + rng.normal(0, noise.key_points, (21, 2)) * np.where(far, noise.astray, 1.0)[:, None]
        alpha = _ragged(raster.alpha, noise.ragged, rng)
        measured = _measured(raster.depth_map, raster.alpha, noise, rng) if depth else None
        return Picture(camera, places, alpha, measured, name)


def _ragged(alpha: Array, pixels: float, rng: np.random.Generator) -> Array:
    """A mask whose outline wanders by about some pixels, smoothly along it, with small bits lost and gained."""
    if not pixels:
        return alpha
    soft = gaussian_filter(alpha, 2.0 * pixels)
    wander = gaussian_filter(rng.normal(size=alpha.shape), 4.0)
    mask = soft + 0.15 * np.clip(wander / wander.std(), -2.5, 2.5) > 0.5
    return binary_opening(binary_closing(mask)).astype(np.float32)


def _measured(depth: Array, alpha: Array, noise: Noise, rng: np.random.Generator) -> Array:
    """Depth of a sensor: smooth and white errors, holes, and the outermost pixels mixed with what is behind."""
    smooth = gaussian_filter(rng.normal(size=depth.shape), 6.0)
    found = depth + noise.depth * (0.6 * smooth / smooth.std() + 0.8 * rng.normal(size=depth.shape))
    found = np.where((alpha > 0.02) & (alpha < 0.98), found + rng.uniform(0, 0.3, depth.shape), found)
    lost = gaussian_filter(rng.random(depth.shape), 1.5)
    found[lost < np.quantile(lost, noise.holes)] = 0.0
    return np.where(alpha > 0.02, found, 0.0).astype(np.float32)


def camera(width: int = 384, height: int = 512, distance: float = 0.5) -> Camera:
    """A phone's camera that looks at the origin from +z."""
    K = np.array([[1.6 * width, 0, width / 2], [0, 1.6 * width, height / 2], [0, 0, 1]])
    pose = np.c_[np.diag([1.0, -1.0, -1.0]), [0.0, 0.05, distance]]
    return Camera("phone", width, height, K, pose)


def sitter(rng: np.random.Generator, noise: Noise = Noise(), pose: Pose | None = None) -> Sitter:
    """A random adult in a random pose (or a given one), any side towards the camera, the forearm more down than up."""
    hand = hand_model()
    joints = (pose or hand.sample_pose(rng)).joints
    angles = [rng.normal(0, 35), rng.uniform(-50, 50), rng.uniform(-180, 180)]
    turn = Rotation.from_euler("zxy", angles, degrees=True).as_rotvec()
    shape = np.asarray(hand.sample_identity(rng), dtype=np.float64)
    return Sitter(hand, shape, Pose(joints, turn, rng.normal(0, 0.01, 3)), camera(), noise)


class Errors(NamedTuple):
    """Mean distances of vertices from the truth in metres: as they are; after scaling about the camera, which one
    picture cannot tell; with both wrists in one place."""

    absolute: float
    scaled: float
    rooted: float


def errors(true: Sitter, found: Fit, index: int = 0) -> Errors:
    """How far a fitted hand is from the true one."""
    pose = found.pictures[index].pose
    assert pose is not None
    ours, theirs = found.hand.posed(found.shape, pose)[0], true.vertices
    a, b = ours - true.camera.centre, theirs - true.camera.centre
    scale = float((a * b).sum() / (a * a).sum())
    moved = pose.translation - true.pose.translation
    return Errors(*(float(np.linalg.norm(off, axis=1).mean()) for off in (ours - theirs, scale * a - b, a - b - moved)))
