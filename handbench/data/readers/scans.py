"""Phone scans in the two layouts that UHM reads: its own, for anybody's video, and Goliath's iPhone captures."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...files import read_json, read_text
from ...hand.mano.unpickle import read_pickle
from ...scene import Array
from ..codes import read_codes
from ..picturesize import picture_size
from .keypoints import TIPS_FIRST, fields, shaped
from .zipped import FileSet, Zips

LISTS = {"train": "frame_list_train.txt", "test": "frame_list_test.txt"}
FOCAL = 2000.0
"""Pixels of a camera that is not told, as the authors take it; its axis goes through the middle."""

_LIMIT = 16 << 20  # bytes of a list or an estimate
_FIT = {"root_pose": 3, "hand_pose": 45, "shape": 10}
_NAME = re.compile(r"[\w-][\w.-]{0,63}")


@dataclass(frozen=True)
class Moment:
    """A frame of a scan: `segment` is the list that names it."""

    sequence: str
    number: str
    segment: str


@dataclass(frozen=True, eq=False)
class Lens:
    """Focal lengths and principal point in pixels, and the pictures' size."""

    focal: Array
    centre: Array
    size: tuple[int, int]


class Scan(ABC):
    """One person's scan. All but `moments` and `lens` read one frame's files when they are asked."""

    subject: str
    folder: Path

    @abstractmethod
    def moments(self) -> Iterator[Moment]:
        """The listed frames that are there."""

    @abstractmethod
    def lens(self, sequence: str, number: str) -> Lens:
        """The camera of a sequence; `number` is one of its frames."""

    @abstractmethod
    def codes(self, moment: Moment) -> Array:
        """sRGB codes (H, W, 3) uint8."""

    @abstractmethod
    def mask(self, moment: Moment) -> Array:
        """How much of each pixel is hand, (H, W) float32."""

    @abstractmethod
    def key_points(self, moment: Moment) -> Array:
        """Detected key points (21, 3) in our order."""

    @abstractmethod
    def depth(self, moment: Moment) -> Array | None:
        """Metres along z, (h, w) float32, not above 0 where there is none; not always of the picture's size."""

    @abstractmethod
    def fit(self, moment: Moment) -> dict[str, Array]:
        """root_pose (3,), hand_pose (45,) relative to the mean pose, shape (10,)."""

    def lines(self, segment: str) -> Iterator[list[str]]:
        """The words of each line of a segment's list. Raises `InputError` for a sequence that is no plain name."""
        path = self.folder / LISTS[segment]
        for line in read_text(path, _LIMIT, "frame list").splitlines() if path.is_file() else ():
            words = line.split()
            if words and not _NAME.fullmatch(words[0]):
                raise InputError(f"frame list {path}: sequence {words[0][:60]!r} is no folder's name; mend it")
            if words:
                yield words

    def _pair(self, words: list[str], count: int) -> list[int]:
        try:
            found = [int(word) for word in words[1:]]
        except ValueError:
            found = []
        if len(found) != count or min(found) < 0:
            wanted = "sequence and frame" if count == 1 else "sequence, first and last frame"
            raise InputError(f"{self.folder}: a frame list has a line {' '.join(words)[:60]!r}; expected {wanted}")
        return found


class OwnScan(Scan):
    """SUBJECT/{frame_list_train.txt, frame_list_test.txt}, and for each video frames/0.png, masks/0.png,
    keypoints/0.json, mano_params/params/0.json, and if there are any depthmaps/0.pkl and cam_param.json."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.subject = folder, folder.name

    def moments(self) -> Iterator[Moment]:
        for segment in LISTS:
            for words in self.lines(segment):
                (number,) = self._pair(words, 1)
                found = Moment(words[0], str(number), segment)
                if all(self._file(found, *kind).is_file() for kind in _NEEDED):
                    yield found

    def lens(self, sequence: str, number: str) -> Lens:
        size = picture_size(self._file(Moment(sequence, number, ""), "frames", ".png"))
        path = self.folder / sequence / "cam_param.json"
        if not path.is_file():
            return Lens(np.full(2, FOCAL), 0.5 * np.array(size), size)
        told = fields(read_json(path, _LIMIT, "camera file"), {"focal": 2, "princpt": 2}, f"camera file {path}")
        return Lens(told["focal"], told["princpt"], size)

    def codes(self, moment: Moment) -> Array:
        return read_codes(self._file(moment, "frames", ".png"), said=True).values[..., :3]

    def mask(self, moment: Moment) -> Array:
        values = read_codes(self._file(moment, "masks", ".png"), "mask", said=True).values
        values = values.astype(np.float32) / (255.0 if values.dtype.kind == "u" else 1.0)
        return values if values.ndim == 2 else values[..., 0]

    def key_points(self, moment: Moment) -> Array:
        path = self._file(moment, "keypoints", ".json")
        return np.c_[shaped(read_json(path, _LIMIT, "key points"), (21, 2), f"key points {path}"), np.ones(21)]

    def depth(self, moment: Moment) -> Array | None:
        path = self._file(moment, "depthmaps", ".pkl")
        if not path.is_file():
            return None
        found = np.asarray(read_pickle(path, "depth map"))
        if found.dtype.kind != "f" or found.size == 0 or found.ndim not in (2, 3) or found.shape[2:] not in ((), (1,)):
            raise InputError(f"depth map {path} has shape {found.shape} of {found.dtype}; expected (H, W) of metres")
        return found.reshape(found.shape[:2]).astype(np.float32)

    def fit(self, moment: Moment) -> dict[str, Array]:
        path = self._file(moment, "mano_params/params", ".json")
        return fields(read_json(path, _LIMIT, "fit"), _FIT, f"fit {path}")

    def _file(self, moment: Moment, kind: str, suffix: str) -> Path:
        return self.folder / moment.sequence / kind / f"{moment.number}{suffix}"


_NEEDED = (("frames", ".png"), ("masks", ".png"), ("keypoints", ".json"), ("mano_params/params", ".json"))


class GoliathScan(Scan):
    """m--…--ID--pilot--ProjectGoliath--iPhone/Hands/{camera_calibration.txt, frame_list_train.txt, …, SIDE/}: of a side
    rgb/000000.avif, segmentations_fgbg/000000.png, keypoints_2d/000000.bin, mano/params/000000_right.json and
    depth/000000.bin, each in a folder or in the .zip of its name."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        parts = folder.parent.name.split("--")
        self.subject = parts[3] if len(parts) > 4 else folder.parent.name if folder.name == "Hands" else folder.name
        self._zips = Zips()
        self._kept: dict[tuple[str, str], FileSet] = {}

    def moments(self) -> Iterator[Moment]:
        for segment in LISTS:
            for words in self.lines(segment):
                first, last = self._pair(words, 2)
                pictures, fitted = (self._of(words[0], kind).names() for kind in ("rgb", "mano"))
                for number in sorted(int(n[:6]) for n in pictures if re.fullmatch(r"\d{6}\.avif", n)):
                    if first <= number <= last and f"params/{number:06d}_right.json" in fitted:
                        yield Moment(words[0], f"{number:06d}", segment)

    def lens(self, sequence: str, number: str) -> Lens:
        rows = self._calibration
        height, width = self.codes(Moment(sequence, number, "")).shape[:2]
        return Lens(np.array([rows[0, 0], rows[1, 1]]), rows[:2, 2], (width, height))

    def codes(self, moment: Moment) -> Array:
        return self._of(moment.sequence, "rgb").picture(f"{moment.number}.avif")[..., :3]

    def mask(self, moment: Moment) -> Array:
        codes = self._of(moment.sequence, "segmentations_fgbg").picture(f"{moment.number}.png")
        return (codes if codes.ndim == 2 else codes[..., 0]).astype(np.float32) / 255.0

    def key_points(self, moment: Moment) -> Array:
        found = self._floats(moment, "keypoints_2d")
        if len(found) % 3 or len(found) < 3 * 42:
            raise InputError(f"{self.folder}: key points {moment.number} are {len(found)} numbers, expected (N, 3)")
        return found.reshape(-1, 3)[21:42][list(TIPS_FIRST)].astype(
            np.float64
        )  # the body's first, the left hand's last

    def depth(self, moment: Moment) -> Array | None:
        if f"{moment.number}.bin" not in self._of(moment.sequence, "depth").names():
            return None
        found = self._floats(moment, "depth")
        if len(found) != 640 * 360:
            raise InputError(f"{self.folder}: depth {moment.number} has {len(found)} numbers, expected 640 x 360")
        return 0.001 * found.reshape(640, 360)

    def fit(self, moment: Moment) -> dict[str, Array]:
        name = f"params/{moment.number}_right.json"
        path = self.folder / moment.sequence / "mano" / name
        return fields(self._of(moment.sequence, "mano").json(name), _FIT, f"fit {path}")

    @cached_property
    def _calibration(self) -> Array:
        """K (3, 3) of the colour camera, which is the file's first: a name, then its rows."""
        path = self.folder / "camera_calibration.txt"
        lines = read_text(path, _LIMIT, "camera file").splitlines()
        try:
            return shaped([[float(x) for x in line.split()] for line in lines[1:4]], (3, 3), f"camera file {path}")
        except ValueError as error:
            raise InputError(f"camera file {path} has no three rows of K below a name; get it anew") from error

    def _floats(self, moment: Moment, kind: str) -> Array:
        content = self._of(moment.sequence, kind).read(f"{moment.number}.bin")
        if len(content) % 4:
            raise InputError(f"{self.folder}: {kind} {moment.number} is cut off; get it anew")
        return np.frombuffer(content, "<f4")

    def _of(self, sequence: str, kind: str) -> FileSet:
        if (sequence, kind) not in self._kept:
            self._kept[sequence, kind] = FileSet(self._zips, self.folder / sequence, kind)
        return self._kept[sequence, kind]
