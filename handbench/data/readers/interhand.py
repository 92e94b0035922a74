"""InterHand2.6M (Moon et al., 2020): single right hands with MANO fits, 512 x 334, many cameras, one studio light.

Layout: images/SPLIT/CaptureN/SEQUENCE/camID/imageFRAME.jpg and
annotations/SPLIT/InterHand2.6M_SPLIT_{camera,joint_3d, MANO_NeuralAnnot}.json. Millimetres, but for MANO's metres.
A camera's translation is -R campos. MANO's poses are relative to the mean pose, and its parameters are in the
world. There are no masks: a folder masks/ of the pictures' layout (.png) is used if it is there, else what the fit
covers. Pixel centres count from 0 there, from 0.5 here. Licence: CC BY-NC 4.0.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...evenly import evenly
from ...method import Progress, silent
from ...recording import Need
from ...scene import Array, Camera, Frame, Mesh, Observation, Pose, Unknown
from ..capture import Capture
from ..pictures import Stated, read_mask, read_picture
from .annotations import Annotations
from .keypoints import projected
from .mano import posed, right_hand
from .masked import covered
from .place import check_size, lacking, listed, place_of

if TYPE_CHECKING:
    from ...hand.mano import ManoHand

NAME = "interhand"
SIZES = ("released", "palm")
PALM = {
    ("Capture0", "ROM03"): ("400262", "400451"),
    ("Capture0", "ROM04"): ("400275", "400418"),
    ("Capture0", "ROM05"): ("400270", "400488"),
    ("Capture1", "ROM03"): ("400456", "400486"),
    ("Capture1", "ROM04"): ("400266", "400439"),
    ("Capture1", "ROM05"): ("400314", "400469"),
}
"""The twelve sequences that PALM evaluates on, each with the camera that sees it; all are of the train split."""
PALM_MOMENTS = 20

_SPLITS = ("train", "val", "test")
_LIGHT = Unknown("studio")
_NUMBER = re.compile(r"[0-9]+")


def fits(folder: Path) -> bool:
    """Whether a folder is of this layout."""
    return (folder / "annotations").is_dir() and any((folder / "images" / split).is_dir() for split in _SPLITS)


def open_capture(size: str = "released", folder: Path | None = None, progress: Progress = silent) -> InterHandCapture:
    """InterHand2.6M on the user's disk: "released", or "palm", the twelve sequences of PALM's evaluation."""
    check_size(NAME, size, SIZES)
    return InterHandCapture(place_of(NAME, folder, fits), size)


class InterHandCapture(Capture):
    """Pictures of single right hands that MANO was fitted to; others are left out and counted in `remarks`."""

    layout = "InterHand2.6M"

    def __init__(self, folder: Path, size: str = "released") -> None:
        self.folder, self.name = folder, f"{NAME}-{size}"
        self._hand, self._why = right_hand()
        self.hand = None if self._hand is None else self._hand.name
        self._left_out = 0
        self.drawn_masks = not (folder / "masks").is_dir()
        self._places: dict[str, tuple[Annotations, str, str]] = {}  # by pose key: capture, folder of the sequence
        self._digest = hashlib.sha256(size.encode())
        built = self._palm() if size == "palm" else self._released()
        self._frames = listed(built)
        if not self._frames:
            raise InputError(
                f"{folder} has no picture of a single right hand with a fit; get its images and annotations"
            )
        self.digest = self._digest.hexdigest()

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    @property
    def offers(self) -> frozenset[Need]:
        points: frozenset[Need] = frozenset({"keypoints"})
        found = super().offers | points
        return found if self._hand is not None or not self.drawn_masks else found - {"alpha"}

    @property
    def remarks(self) -> tuple[str, ...]:
        found = list(self._why)
        if self._left_out:
            found.append(f"{self._left_out} moments are of a left hand, of two, or without a fit, and are left out")
        if self.drawn_masks and self._hand is not None:
            found.append(
                "masks are what the fitted hand covers, which is off by some 5 mm; bring a folder masks/ for others"
            )
        return tuple(found)

    def observe(self, frame: Frame) -> Observation:
        said, capture, sequence = self._places[frame.pose_key]
        place = f"{sequence}/{frame.camera.name}/image{frame.pose_name}"
        image = read_picture(self.folder / "images" / f"{place}.jpg", Stated()).image
        mask = self.folder / "masks" / f"{place}.png"
        alpha = read_mask(mask) if mask.is_file() else None
        if alpha is None and frame.mesh is not None:
            alpha = covered(frame.mesh, frame.camera)
        points, valid = said.joints(capture, frame.pose_name)
        seen = projected(points, frame.camera) * np.c_[np.ones((len(points), 2)), valid]
        return Observation(image if alpha is None else image * alpha[..., None], alpha, keypoints=seen)

    # -- how frames are made ----------------------------------------------------------------------------------------

    def _released(self) -> Iterator[Frame]:
        for split in _SPLITS:
            if (self.folder / "images" / split).is_dir():
                said = Annotations(self.folder, split, self._digest)
                for capture in sorted(p.name for p in (self.folder / "images" / split).iterdir() if p.is_dir()):
                    yield from self._capture(said, split, capture)

    def _capture(self, said: Annotations, split: str, capture: str) -> Iterator[Frame]:
        root, subject = self.folder / "images" / split / capture, f"{split}-{capture}"
        cameras: dict[str, Camera] = {}
        moments: dict[str, Frame | None] = {}
        for sequence in _names(root):
            place = root / sequence
            for name in _names(place):
                if not name.startswith("cam") or not (numbers := _numbers(place / name)):
                    continue
                self._digest.update(f"{split}/{capture}/{sequence}/{name} {len(numbers)} {numbers[-1]}".encode())
                if name not in cameras:
                    cameras[name] = said.camera(capture, name, place / name / f"image{numbers[0]}.jpg")
                camera = cameras[name]
                for number in numbers:
                    if number not in moments:
                        moment = self._moment(said, capture, subject, number, f"{split}/{capture}/{sequence}")
                        moments[number] = None if moment is None else moment.frame(subject, number, camera, sequence)
                    if (frame := moments[number]) is not None:
                        yield frame.seen_by(camera)

    def _palm(self) -> Iterator[Frame]:
        said = Annotations(self.folder, "train", self._digest)
        for (capture, movement), cameras in PALM.items():
            root = self.folder / "images" / "train" / capture
            found = sorted(p.name for p in root.glob(f"{movement}*") if p.is_dir())
            if not found:
                raise lacking(self.folder, f"images/train/{capture}/{movement}…")
            for identity in cameras:
                place = root / found[0] / f"cam{identity}"
                subject = f"c{capture[-1]}-{movement}-{identity}"
                moments = {
                    number: moment
                    for number in (_numbers(place) if place.is_dir() else ())
                    if (moment := self._moment(said, capture, subject, number, f"train/{capture}/{found[0]}"))
                }
                if not moments:
                    raise lacking(self.folder, f"images/train/{capture}/{found[0]}/cam{identity} with fits")
                camera = said.camera(capture, f"cam{identity}", place / f"image{next(iter(moments))}.jpg")
                for i, number in enumerate(evenly(list(moments), PALM_MOMENTS)):
                    yield moments[number].frame(subject, number, camera, "sequence" if i else "fit", i)

    def _moment(self, said: Annotations, capture: str, subject: str, number: str, place: str) -> _Moment | None:
        fit = said.fit(capture, number)
        if fit is None:
            self._left_out += 1
            return None
        self._places[f"{subject}/{number}"] = said, capture, place
        return _Moment(self._hand, fit)


class _Moment:
    """What the cameras of a moment share: pose, shape and mesh, each worked out when it is asked for."""

    def __init__(self, hand: ManoHand | None, fit: dict[str, Any]) -> None:
        self.pose: Pose | None = None
        self.shape: Array | None = None
        self.mesh: Mesh | None = None
        if hand is not None:
            self.shape = np.array(fit["shape"], np.float64)
            self.shape.flags.writeable = False
            self.pose = Pose.unread(partial(_pose, hand, fit))
            self.mesh = posed(hand, self.shape, self.pose)

    def frame(self, subject: str, number: str, camera: Camera, segment: str, moment: int | None = None) -> Frame:
        who = (subject, number, "studio", self.pose, self.mesh, camera, _LIGHT)
        return Frame(*who, segment, "full", self.shape, moment)


def _pose(hand: ManoHand, fit: dict[str, Any]) -> Pose:
    told = np.array(fit["pose"], np.float64)
    return hand.pose_of(told[3:], told[:3], fit["trans"], fit["shape"], flat_hand_mean=False)


def _numbers(folder: Path) -> list[str]:
    """The numbers of a folder's pictures, as their names write them, in order."""
    found = [name[5:-4] for name in _names(folder) if name.startswith("image") and name.endswith(".jpg")]
    return sorted(filter(_NUMBER.fullmatch, found), key=int)


def _names(folder: Path) -> list[str]:
    return sorted(os.listdir(folder))  # noqa: PTH208  (a path for each of a million names takes seconds)
