"""Fitting the open hand to pictures of itself at realistic noise: `python -m benchmarks.fitting`.

Errors against the truth and time, by what is given and by pose; a phone scan. Fits to the open captures, and how often
what is wrong is told: `fitting_captures.py`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_closing, binary_opening, gaussian_filter
from scipy.spatial.transform import Rotation

from handbench.hand import HandModel, hand_model
from handbench.hand.fitting import Fit, HandPicture, fit
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import rasterise
from handbench.scene import Array, Camera, Mesh, Pose

LEVEL = 2  # of the surface that is photographed; fits see coarser ones


@dataclass(frozen=True)
class CaptureNoise:
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
    noise: CaptureNoise

    @property
    def vertices(self) -> Array:
        """True coarse vertices (V, 3) in the world."""
        return self.hand.posed(self.shape, self.pose)[0]

    def picture(self, rng: np.random.Generator, depth: bool, name: str = "picture") -> HandPicture:
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
        return HandPicture(camera, places, alpha, measured, name)


def _ragged(alpha: Array, pixels: float, rng: np.random.Generator) -> Array:
    """A mask whose outline wanders by about some pixels, smoothly along it, with small bits lost and gained."""
    if not pixels:
        return alpha
    soft = gaussian_filter(alpha, 2.0 * pixels)
    wander = gaussian_filter(rng.normal(size=alpha.shape), 4.0)
    mask = soft + 0.15 * np.clip(wander / wander.std(), -2.5, 2.5) > 0.5
    return binary_opening(binary_closing(mask)).astype(np.float32)


def _measured(depth: Array, alpha: Array, noise: CaptureNoise, rng: np.random.Generator) -> Array:
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


def sitter(rng: np.random.Generator, noise: CaptureNoise = CaptureNoise(), pose: Pose | None = None) -> Sitter:
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
    moved = pose.translation - true.pose.translation
    return errors_of(found.hand.posed(found.shape, pose)[0], true.vertices, true.camera, moved)


def errors_of(ours: Array, theirs: Array, camera: Camera, moved: Array) -> Errors:
    """How far vertices (V, 3) before a camera are from the true ones; `moved` (3,) is how far the wrist is."""
    a, b = ours - camera.centre, theirs - camera.centre
    scale = float((a * b).sum() / (a * a).sum())
    return Errors(*(float(np.linalg.norm(off, axis=1).mean()) for off in (a - b, scale * a - b, a - b - moved)))


def scan(rng: np.random.Generator, count: int, noise: CaptureNoise = CaptureNoise()) -> list[Sitter]:
    """A hand with nearly still fingers that turns once in front of a phone, as a person scans it."""
    hand = hand_model()
    shape = np.asarray(hand.sample_identity(rng), dtype=np.float64)
    still = hand.named_pose("rest").joints
    drift = gaussian_filter(rng.normal(size=(count, *still.shape)), (count / 12, 0, 0)) * np.sqrt(count / 3)
    frames = []
    for i in range(count):
        joints = (
            np.clip(still + np.radians(2.0) * drift[i], *np.moveaxis(hand.limits, 2, 0))
            if hand.limits is not None
            else still
        )
        angles = [10 * np.sin(4 * i / count), 20 * np.sin(7 * i / count), 360 * i / count]
        turn = Rotation.from_euler("zxy", angles, degrees=True).as_rotvec()
        frames.append(Sitter(hand, shape, Pose(joints, turn, rng.normal(0, 0.002, 3)), camera(), noise))
    return frames


# -- measurements ---------------------------------------------------------------------------------------------------

GIVEN: dict[str, Callable[[HandPicture], HandPicture]] = {
    "key points": lambda picture: replace(picture, alpha=None, depth=None),
    "key points, mask": lambda picture: replace(picture, depth=None),
    "key points, mask, depth": lambda picture: picture,
}
POSES = ("random", "open", "fist", "point", "pinch")


def singles(count: int, poses: tuple[str, ...]) -> None:
    """Errors and seconds of one picture, by what is given and by pose."""
    print("\none picture: mean vertex error in mm, mean (worst) of people; seconds of a core")
    print(f"{'given':26}{'pose':8}{'absolute':>16}{'up to scale':>16}{'converged':>11}{'s':>7}")
    for given, kept in GIVEN.items():
        for name in poses:
            found, good, took = [], 0, []
            for seed in range(count):
                rng = np.random.default_rng([seed, 7])
                pose = None if name == "random" else hand_model().named_pose(name)
                true = sitter(rng, pose=pose)
                picture = kept(true.picture(rng, depth=True))
                start = time.process_time()
                fitted = fit(true.hand, [picture])
                took.append(time.process_time() - start)
                good += fitted.converged
                found.append(errors(true, fitted))
            print(f"{given:26}{name:8}{_line([e.absolute for e in found])}{_line([e.scaled for e in found])}", end="")
            print(f"{good:>8}/{count:<2}{np.median(took):7.1f}", flush=True)


def scans(count: int, frames: int) -> None:
    """Errors and seconds of phone scans."""
    print(
        f"\nscans of {frames} pictures with depth: mean vertex error in mm, mean (worst) of pictures; seconds of a core"
    )
    for seed in range(count):
        rng = np.random.default_rng([seed, 8])
        true = scan(rng, frames)
        pictures = [one.picture(rng, True, f"frame {i}") for i, one in enumerate(true)]
        start = time.process_time()
        fitted = fit(true[0].hand, pictures)
        took = time.process_time() - start
        found = [errors(one, fitted, i).absolute for i, one in enumerate(true)]
        print(f"person {seed}  {_line(found)}  {took:.1f} s  {fitted.reason or 'converged'}", flush=True)


def _line(values: list[float]) -> str:
    return f"{1e3 * np.mean(values):9.1f} ({1e3 * np.max(values):4.1f})"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fitting", description=__doc__)
    parser.add_argument("what", nargs="*", choices=["singles", "poses", "scans"], default=["singles", "scans"])
    parser.add_argument("--count", type=int, default=12, help="people (default: 12)")
    parser.add_argument("--frames", type=int, default=60, help="pictures of a scan (default: 60)")
    arguments = parser.parse_args()
    for what in arguments.what:
        match what:
            case "singles":
                singles(arguments.count, POSES[:1])
            case "poses":
                singles(arguments.count, POSES[1:])
            case "scans":
                scans(arguments.count, arguments.frames)


if __name__ == "__main__":
    main()
