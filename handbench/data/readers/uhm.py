"""Phone scans as UHM reads them (Moon et al., 2024): a hand before a phone that stands still, depth where it has some.

Layouts: scans.py. Poses and shapes are InterWild's estimates of MANO, relative to the mean pose; they do not tell where
the hand is, so here it is put where its key points lie on those that were detected (least squares in the pictures).
Depth is kept where it is within 15 cm of the hand's median, as the authors do about the wrist. The light is not known.

What is assumed, as no document says it: codes are sRGB, K and key points count pixels from the upper left corner, and a
person's sequences are in one light. Right hands alone, as by the authors' reader. Goliath's scans: CC BY-NC 4.0.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...errors import InputError
from ...method import Progress, silent
from ...recording import Need
from ...scene import Array, Camera, Frame, Observation, Pose, Unknown
from ...scene.colour import linear
from ..capture import Capture
from ..poses import turned
from .mano import posed, right_hand
from .place import check_size, listed, place_of
from .scans import LISTS, GoliathScan, Lens, Moment, OwnScan, Scan

if TYPE_CHECKING:
    from ...hand.mano import ManoHand

NAME = "uhm"
SIZES = ("released",)

_TURN = np.diag([1.0, -1.0, -1.0])  # from the camera's axes to a world with +y up
_NEAR = 0.15  # metres about the hand's depth
_AWAY = 0.05  # metres: a hand that is nearer to the lens is none


def fits(folder: Path) -> bool:
    """Whether a folder is one scan of these layouts, or holds some."""
    return bool(_scans(folder))


def open_capture(size: str = "released", folder: Path | None = None, progress: Progress = silent) -> UhmCapture:
    """Phone scans on the user's disk: one, or a folder of several people's."""
    check_size(NAME, size, SIZES)
    return UhmCapture(place_of(NAME, folder, fits))


class UhmCapture(Capture):
    """Moving right hands before one phone. Segments are the lists, "train" and "test"."""

    layout = "UHM's phone scans"

    def __init__(self, folder: Path) -> None:
        self.folder, self.name = folder, NAME
        self._hand, self._why = right_hand()
        self.hand = None if self._hand is None else self._hand.name
        self._moments: dict[str, tuple[Scan, Moment]] = {}  # by pose key
        self._digest = hashlib.sha256()
        self._frames = listed(frame for scan in _scans(folder) for frame in self._scan(scan))
        if not self._frames:
            raise InputError(f"{folder} has no frames with picture, mask, key points and fit; complete the scan")
        self.digest = self._digest.hexdigest()

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    @property
    def offers(self) -> frozenset[Need]:
        found: frozenset[Need] = frozenset({"keypoints", "depth"} if self._deep else {"keypoints"})
        return super().offers | found

    @property
    def remarks(self) -> tuple[str, ...]:
        if self._hand is None:
            return self._why
        return ("where a hand is, is not told: it is put where its key points lie on those that were detected",)

    def observe(self, frame: Frame) -> Observation:
        scan, moment = self._moments[frame.pose_key]
        image = linear(scan.codes(moment).astype(np.float32) / 255.0)
        alpha = scan.mask(moment)
        if alpha.shape != image.shape[:2]:
            raise InputError(f"{frame.key}: its mask is {alpha.shape[1]}x{alpha.shape[0]}, its picture is not")
        depth = scan.depth(moment)
        near = None if depth is None else _near(_enlarged(depth, alpha.shape), alpha)
        return Observation(image * alpha[..., None], alpha, depth=near, keypoints=scan.key_points(moment))

    @cached_property
    def _deep(self) -> bool:
        return all(scan.depth(moment) is not None for scan, moment in _firsts(self._moments))

    def _scan(self, scan: Scan) -> Iterator[Frame]:
        light = Unknown(f"{scan.subject}-light")
        cameras: dict[str, Camera] = {}
        counts: dict[str, int] = {}
        for moment in scan.moments():
            if moment.sequence not in cameras:
                cameras[moment.sequence] = _camera(moment.sequence, scan.lens(moment.sequence, moment.number))
            camera, name = cameras[moment.sequence], f"{moment.sequence}-{moment.number}"
            if f"{scan.subject}/{name}" in self._moments:
                raise InputError(f"{scan.folder}: frame {name} is listed twice; list it in one of {', '.join(LISTS)}")
            self._moments[f"{scan.subject}/{name}"] = scan, moment
            self._digest.update(f"{scan.subject}/{name} {moment.segment}".encode())
            counts[moment.sequence] = place = counts.get(moment.sequence, -1) + 1
            pose = shape = mesh = None
            if self._hand is not None:
                shape = scan.fit(moment)["shape"]
                pose = Pose.unread(partial(_pose, self._hand, scan, moment, camera))
                mesh = posed(self._hand, shape, pose)
            who = (scan.subject, name, light.name, pose, mesh, camera, light, moment.segment)
            yield Frame(*who, "environment", shape, place)


def _scans(folder: Path) -> list[Scan]:
    """The scans in a folder: itself, the people in it, or the hands of Goliath's captures in it."""
    below = sorted(p for p in folder.iterdir() if p.is_dir())
    for places in ([folder], [folder / "Hands"], below, [p / "Hands" for p in below]):
        listed = [p for p in places if any((p / name).is_file() for name in LISTS.values())]
        found = [scan for place in listed if (scan := _of_layout(place)) is not None]
        if found:
            return found
    return []


def _of_layout(place: Path) -> Scan | None:
    if (place / "camera_calibration.txt").is_file():
        return GoliathScan(place)
    return OwnScan(place) if any(place.glob("*/mano_params/params")) else None


def _firsts(moments: dict[str, tuple[Scan, Moment]]) -> list[tuple[Scan, Moment]]:
    """The first moment of each sequence."""
    found: dict[tuple[Path, str], tuple[Scan, Moment]] = {}
    for scan, moment in moments.values():
        found.setdefault((scan.folder, moment.sequence), (scan, moment))
    return list(found.values())


def _camera(name: str, lens: Lens) -> Camera:
    (fx, fy), (cx, cy) = lens.focal, lens.centre
    return Camera(name, *lens.size, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), np.c_[_TURN, np.zeros(3)])


def _pose(hand: ManoHand, scan: Scan, moment: Moment, camera: Camera) -> Pose:
    fit = scan.fit(moment)

    def at(place: Array) -> Pose:
        return hand.pose_of(fit["hand_pose"], fit["root_pose"], place, fit["shape"], flat_hand_mean=False)

    _, points = hand.posed(fit["shape"], at(np.zeros(3)))
    place = placed(points[list(hand.key_points)], scan.key_points(moment), camera.K)
    if place[2] < _AWAY:
        raise InputError(f"{scan.subject}/{moment.sequence}-{moment.number}: its key points are those of no hand")
    return turned(at(place), _TURN)


def placed(points: Array, seen: Array, K: Array) -> Array:
    """The translation (3,) that brings points (N, 3) in the camera's axes nearest to where they are seen, (N, 3).

    Least squares of (x - c)(Z + t_z) = f (X + t_x) and the same for y, weighted by how sure each is: linear in t.
    """
    off = (seen[:, :2] - K[:2, 2]) / K[[0, 1], [0, 1]]
    left = np.concatenate([np.c_[np.tile(row, (len(off), 1)), -off[:, i]] for i, row in enumerate(np.eye(2))])
    right = np.concatenate([off[:, i] * points[:, 2] - points[:, i] for i in range(2)])
    sure = np.tile(np.sqrt(seen[:, 2].clip(0)), 2)
    found: Array = np.linalg.lstsq(left * sure[:, None], right * sure, rcond=None)[0]
    return found


def _enlarged(depth: Array, size: tuple[int, ...]) -> Array:
    """A depth map at a picture's size, the nearest value for each pixel."""
    rows, columns = (((np.arange(n) + 0.5) * m / n).astype(int) for n, m in zip(size, depth.shape, strict=True))
    return depth[rows[:, None], columns]


def _near(depth: Array, alpha: Array) -> Array:
    """Depth that is the hand's; 0 elsewhere."""
    told = (depth > 0) & np.isfinite(depth) & (alpha > 0)
    if not told.any():
        return np.zeros_like(depth)
    return np.where(told & (np.abs(depth - np.median(depth[told])) < _NEAR), depth, 0.0).astype(np.float32)
