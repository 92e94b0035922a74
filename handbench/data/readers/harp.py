"""HARP (Karunratanakul et al., 2023): a hand filmed by one camera, with METRO's estimates of MANO.

Layout: subject_N/SEQUENCE/{unscreen_cropped/0001.jpg, mask/0001_mask.jpg, metro_mano/0001_mano.pkl}; sequences 1 to
5 are fitted, 6 to 9 tested. Cameras are weak perspective (s, tx, ty): here a perspective one with a focal length of
2,000 pixels of 448, with the hand at (tx, ty, 2 f / (size s)) in OpenCV's axes. Poses are relative to the mean
pose. The light is not known.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...errors import InputError
from ...hand.mano.unpickle import read_pickle
from ...method import Progress, silent
from ...recording import Need
from ...scene import Array, Camera, Frame, Observation, Pose, Unknown
from ..capture import Capture
from ..codes import read_codes
from ..pictures import read_picture
from ..picturesize import picture_size
from ..poses import turned
from .keypoints import fields
from .mano import posed, right_hand
from .place import check_size, listed, place_of

if TYPE_CHECKING:
    from ...hand.mano import ManoHand

NAME = "harp"
SIZES = ("released",)
FITTED = ("1", "2", "3", "4", "5")
"""The sequences that HARP fits; the others are its test."""

_FOCAL, _FOR = 2000.0, 448  # pixels, of a picture of so many
_LIMIT = 1 << 22  # bytes of an estimate
_TURN = np.diag([1.0, -1.0, -1.0])  # from the camera's axes, in which MANO is told, to a world with +y up
_NAME = re.compile(r"(\d+)_mano\.pkl")
_SIZES = {"rot": 3, "pose": 45, "shape": 10, "trans": 3, "cam": 3}


def fits(folder: Path) -> bool:
    """Whether a folder is of this layout."""
    return any(folder.glob("subject_*/*/metro_mano"))


def open_capture(size: str = "released", folder: Path | None = None, progress: Progress = silent) -> HarpCapture:
    """HARP's sequences on the user's disk."""
    check_size(NAME, size, SIZES)
    return HarpCapture(place_of(NAME, folder, fits))


class HarpCapture(Capture):
    """Moving hands before one camera. Segments are "fit" and "test"; a pose is named by sequence and number."""

    layout = "HARP"

    def __init__(self, folder: Path) -> None:
        self.folder, self.name = folder, NAME
        self._hand, self._why = right_hand()
        self.hand = None if self._hand is None else self._hand.name
        self._places: dict[str, tuple[Path, str]] = {}
        self._frames = listed(self._build())
        if not self._frames:
            raise InputError(f"{folder} has no pictures with estimates; get HARP's data anew")

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    @cached_property
    def digest(self) -> str:  # type: ignore[override]
        """Of names and sizes of the files."""
        total = hashlib.sha256()
        for place, number in self._places.values():
            for path in _files(place, number):
                total.update(f"{path.relative_to(self.folder)} {path.stat().st_size}".encode())
        return total.hexdigest()

    @property
    def offers(self) -> frozenset[Need]:
        return super().offers | ({"keypoints"} if self._hand is not None else set())

    @property
    def remarks(self) -> tuple[str, ...]:
        return self._why

    def observe(self, frame: Frame) -> Observation:
        picture, mask, _ = _files(*self._places[frame.pose_key])
        image, codes = read_picture(picture).image, read_codes(mask, "mask", said=True).values
        alpha = codes.astype(np.float32) / 255.0
        alpha = alpha.mean(axis=-1) if alpha.ndim == 3 else alpha  # of JPEG: channels differ by a code or two
        if alpha.shape != image.shape[:2]:
            raise InputError(f"mask {mask} is {alpha.shape[1]}x{alpha.shape[0]}, its picture is not")
        return Observation(image * alpha[..., None], alpha, keypoints=self._keypoints(frame))

    def _keypoints(self, frame: Frame) -> Array | None:
        """Those of the estimate: the data have no others."""
        if self._hand is None or frame.pose is None or frame.shape is None:
            return None
        _, points = self._hand.posed(frame.shape, frame.pose)
        places, _ = frame.camera.project(points[list(self._hand.key_points)])
        return np.c_[places, np.ones(len(places))]

    def _build(self) -> Iterator[Frame]:
        for subject in sorted(p for p in self.folder.glob("subject_*") if p.is_dir()):
            for sequence in sorted((p for p in subject.iterdir() if (p / "metro_mano").is_dir()), key=_order):
                light = Unknown(f"{subject.name}-light")  # one room for all sequences of a person
                files = ((m[1], p) for p in (sequence / "metro_mano").iterdir() if (m := _NAME.fullmatch(p.name)))
                for moment, (number, path) in enumerate(sorted(files)):
                    told = _estimate(path)
                    size = picture_size(_files(sequence, number)[0])
                    pose_name = f"{sequence.name}-{number}"
                    self._places[f"{subject.name}/{pose_name}"] = sequence, number
                    pose = shape = mesh = None
                    if self._hand is not None:
                        shape = told["shape"]
                        pose = Pose.unread(partial(_pose, self._hand, told))
                        mesh = posed(self._hand, shape, pose)
                    segment = "fit" if sequence.name in FITTED else "test"
                    camera = _camera(told["cam"], size)
                    who = (subject.name, pose_name, light.name, pose, mesh, camera, light)
                    yield Frame(*who, segment, "environment", shape, moment)


def _order(path: Path) -> tuple[int, str]:
    return (int(path.name), "") if path.name.isdigit() else (1 << 30, path.name)


def _files(sequence: Path, number: str) -> tuple[Path, Path, Path]:
    return (
        sequence / "unscreen_cropped" / f"{number}.jpg",
        sequence / "mask" / f"{number}_mask.jpg",
        sequence / "metro_mano" / f"{number}_mano.pkl",
    )


def _estimate(path: Path) -> dict[str, Array]:
    """METRO's estimate in a file: rot (3,), pose (45,), shape (10,), trans (3,), cam (3,)."""
    return fields(read_pickle(path, "estimate", _LIMIT), _SIZES, f"estimate {path}")


def _camera(cam: Array, size: tuple[int, int]) -> Camera:
    width, height = size
    focal = _FOCAL * width / _FOR
    place = np.array([cam[1], cam[2], 2 * focal / (width * max(float(cam[0]), 1e-9))])
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera("camera", width, height, K, np.c_[_TURN, place])


def _pose(hand: ManoHand, told: dict[str, Array]) -> Pose:
    pose = hand.pose_of(told["pose"], told["rot"], told["trans"], told["shape"], flat_hand_mean=False)
    return turned(pose, _TURN)
