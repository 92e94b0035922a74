"""Re:InterHand (Moon et al., 2023): two hands that interact, relit by a network under photographed environments.

The pictures are no photographs: their truth is how RelightableHands draws a tracked hand.

Layout of a capture m--DATE--TIME--ID--…--two-hands: Mugsy_cameras/cam_params.json (for each camera R, t in
millimetres, focal, princpt), Mugsy_cameras/{envmap_per_frame,envmap_per_segment}/{images,masks}/CAMERA/000000.png,
frame_list.txt (a segment's name and a frame a line), mano_fits/params/FRAME_{right,left}.json (pose, shape, trans),
orig_fits/right/Keypoints/keypoint-000000.json (24 joints, millimetres) or keypoints_orig/keypoints_orig/FRAME.json
(42, as InterHand2.6M lists them). MANO's poses are relative to the mean pose, trans is in metres, the world is common.

What is assumed, as no document says it: codes are sRGB, and pixel centres count from 0 as in InterHand2.6M. The
environments themselves are not given out, so the light is not known; Ego_cameras, whose lenses are fish-eyes, are not
read. Licence: CC BY-NC 4.0.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import Absent, InputError
from ...files import read_json, read_text
from ...hand import hand_model
from ...method import Progress, silent
from ...recording import Need
from ...scene import Array, Camera, Frame, Observation, Pose, Unknown
from ..capture import Capture
from ..pictures import Stated, read_mask, read_picture
from ..picturesize import picture_size
from .keypoints import TIPS_FIRST, fields, projected, shaped
from .mano import posed, right_hand
from .masked import seen_beside
from .place import check_size, listed, place_of

if TYPE_CHECKING:
    from ...hand.mano import ManoHand

NAME = "reinterhand"
SIZES = ("released",)

_LIGHTS = {"envmap_per_frame": "frame", "envmap_per_segment": "segment"}
_LIMIT = 64 << 20  # bytes of a list
_FIT = {"pose": 48, "shape": 10, "trans": 3}
_SMALL = 1 << 20  # bytes of a fit
# theirs: wrist, thumb 0 to 4, index, middle and ring 1 to 4, little finger 0 to 4, forearm
_JOINTS = (0, *range(2, 18), *range(19, 23))


def fits(folder: Path) -> bool:
    """Whether a folder is one capture of this layout, or holds some."""
    return bool(_captures(folder))


def open_capture(size: str = "released", folder: Path | None = None, progress: Progress = silent) -> ReInterHandCapture:
    """Re:InterHand's captures on the user's disk: one, or a folder of several."""
    check_size(NAME, size, SIZES)
    return ReInterHandCapture(place_of(NAME, folder, fits))


class ReInterHandCapture(Capture):
    """The right hands of pictures that show two. A frame's mask is what of the right hand the left does not hide.

    Segments are those of frame_list.txt; lightings are named by the frame, or by the segment, that has its own.
    """

    layout = "Re:InterHand"

    def __init__(self, folder: Path) -> None:
        self.folder, self.name = folder, NAME
        self._right, why = right_hand()
        self._left, why_left = _left_hand() if self._right is not None else (None, ())
        self._why = (*why, *why_left)
        self.hand = None if self._right is None else self._right.name
        self._left_out: set[str] = set()  # moments
        self._places: dict[str, Path] = {}  # by subject
        self._digest = hashlib.sha256()
        self._frames = listed(frame for place in _captures(folder) for frame in self._capture(place))
        if not self._frames:
            raise InputError(f"{folder} has no pictures of fitted hands; get its Mugsy_cameras and mano_fits")
        self.digest = self._digest.hexdigest()
        self._pointed = all(_points_of(place) is not None for place in self._places.values())

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    @property
    def offers(self) -> frozenset[Need]:
        points: frozenset[Need] = frozenset({"keypoints"} if self._pointed else ())
        return (super().offers | points) - (frozenset() if self._left is not None else {"alpha"})

    @property
    def remarks(self) -> tuple[str, ...]:
        found = ["pictures are drawn by a network; left hands are not read, and black where they lie before the right"]
        if self._left_out:
            found.append(f"{len(self._left_out)} moments are without a fit of both hands, and are left out")
        return (*self._why, *found)

    def observe(self, frame: Frame) -> Observation:
        place = self._places[frame.subject]
        kind = next(kind for kind, word in _LIGHTS.items() if frame.lighting.startswith(f"{word}-"))
        root, name = place / "Mugsy_cameras" / kind, f"{frame.camera.name}/{frame.pose_name}.png"
        image, alpha = read_picture(root / "images" / name, Stated("srgb")).image, None
        if self._left is not None and frame.mesh is not None:
            both = read_mask(root / "masks" / name)
            if both.shape != image.shape[:2]:
                raise InputError(f"mask {name} is {both.shape[1]}x{both.shape[0]}, its picture is not")
            left = _fit(place, frame.pose_name, "left")
            other = self._left.mesh(left["shape"], _pose(self._left, left), 0)
            alpha = both * seen_beside(frame.mesh, other, frame.camera)
        points = None if not self._pointed else projected(_key_points(place, frame.pose_name), frame.camera)
        return Observation(image if alpha is None else image * alpha[..., None], alpha, keypoints=points)

    def _capture(self, place: Path) -> Iterator[Frame]:
        subject = _subject(place, self._places)
        self._places[subject] = place
        segments, fitted, cameras = _segments(place), _fitted(place), _Cameras(place)
        for kind, word in _LIGHTS.items():
            root = place / "Mugsy_cameras" / kind / "images"
            moments: dict[str, Frame | None] = {}  # by number: as the first camera sees it; None: left out
            for name in _names(root):
                found = [n.removesuffix(".png") for n in _names(root / name) if n.endswith(".png")]
                if not found:
                    continue
                self._digest.update(f"{place.name}/{kind}/{name} {len(found)} {found[-1]}".encode())
                camera = cameras.of(name, root / name / f"{found[0]}.png")
                for number in found:
                    if number not in moments:
                        there = number.isdigit() and int(number) in fitted
                        segment = segments.get(int(number), "unlisted") if there else ""
                        lit = f"{word}-{number if word == 'frame' else segment}"
                        moments[number] = self._frame(subject, number, lit, segment, camera) if there else None
                        if not there:
                            self._left_out.add(f"{subject}/{number}")
                    if (frame := moments[number]) is not None:
                        yield frame.seen_by(camera)

    def _frame(self, subject: str, number: str, lit: str, segment: str, camera: Camera) -> Frame:
        pose = shape = mesh = None
        if self._right is not None:
            told = _fit(self._places[subject], number, "right")
            shape, pose = told["shape"], Pose.unread(partial(_pose, self._right, told))
            mesh = posed(self._right, shape, pose)
        light = Unknown(f"{subject}-{lit}")
        return Frame(subject, number, lit, pose, mesh, camera, light, segment, "environment", shape)


class _Cameras:
    """The cameras of a capture, each made once."""

    def __init__(self, place: Path) -> None:
        self._path = place / "Mugsy_cameras" / "cam_params.json"
        self._table = read_json(self._path, _LIMIT, "camera file")
        self._made: dict[str, Camera] = {}

    def of(self, name: str, picture: Path) -> Camera:
        if name not in self._made:
            said = self._table.get(name) if isinstance(self._table, dict) else None
            told = fields(said, {"R": 9, "t": 3, "focal": 2, "princpt": 2}, f"camera file {self._path}: {name}")
            (fx, fy), (cx, cy) = told["focal"], told["princpt"]
            K = np.array([[fx, 0, cx + 0.5], [0, fy, cy + 0.5], [0, 0, 1]])
            placed = np.c_[told["R"].reshape(3, 3), 0.001 * told["t"]]
            self._made[name] = Camera(name, *picture_size(picture), K, placed)
        return self._made[name]


def _captures(folder: Path) -> list[Path]:
    every = (folder, *sorted(p for p in folder.iterdir() if p.is_dir()))
    return [place for place in every if (place / "Mugsy_cameras" / "cam_params.json").is_file()]


def _subject(place: Path, taken: dict[str, Path]) -> str:
    """The person's number, and of two captures of one number the later's folder."""
    parts = place.name.split("--")
    short = parts[3] if len(parts) > 4 else place.name
    return short if short not in taken else place.name[:64]


def _segments(place: Path) -> dict[int, str]:
    """The segment of each frame that is listed."""
    path = place / "frame_list.txt"
    try:
        rows = [line.split() for line in read_text(path, _LIMIT, "frame list").splitlines() if line.strip()]
        return {int(number): name for name, number in rows}
    except Absent:
        return {}
    except ValueError as error:
        raise InputError(f"frame list {path} has lines that are no segment and frame; get it anew") from error


def _fitted(place: Path) -> set[int]:
    """The frames with fits of both hands."""
    folder = place / "mano_fits" / "params"
    pairs = [name.removesuffix(".json").split("_") for name in _names(folder) if name.endswith(".json")]
    right, left = ({int(p[0]) for p in pairs if p[0].isdigit() and p[1:] == [side]} for side in ("right", "left"))
    return right & left


def _names(folder: Path) -> list[str]:
    return sorted(os.listdir(folder)) if folder.is_dir() else []  # noqa: PTH208  (a path for each name is slow)


def _fit(place: Path, number: str, side: str) -> dict[str, Array]:
    path = place / "mano_fits" / "params" / f"{int(number)}_{side}.json"
    return fields(read_json(path, _SMALL, "fit"), _FIT, f"fit {path}")


def _pose(hand: ManoHand, fit: dict[str, Array]) -> Pose:
    return hand.pose_of(fit["pose"][3:], fit["pose"][:3], fit["trans"], fit["shape"], flat_hand_mean=False)


def _points_of(place: Path) -> Path | None:
    """The folder of key points, of which there are two forms."""
    found = (place / "orig_fits" / "right" / "Keypoints", place / "keypoints_orig" / "keypoints_orig")
    return next((folder for folder in found if folder.is_dir()), None)


def _key_points(place: Path, number: str) -> Array:
    """The right hand's 21 key points in metres, in our order."""
    folder: Any = _points_of(place)
    if folder.name == "Keypoints":
        path = folder / f"keypoint-{int(number):06d}.json"
        return 0.001 * shaped(read_json(path, _SMALL, "key points"), (24, 3), f"key points {path}")[list(_JOINTS)]
    path = folder / f"{int(number)}.json"
    return 0.001 * shaped(read_json(path, _SMALL, "key points"), (42, 3), f"key points {path}")[list(TIPS_FIRST)]


def _left_hand() -> tuple[ManoHand | None, tuple[str, ...]]:
    try:
        hand: ManoHand = hand_model("mano-left")  # type: ignore[assignment]
    except Absent as error:
        return None, (f"masks are not there, as what the left hand hides cannot be drawn: {error}",)
    return hand, ()
