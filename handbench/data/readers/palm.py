"""PALM (Fan et al., 2025): many people's right hands in many poses before seven colour cameras, with MANO
registrations.

Layout: folders/SUBJECT/{cameras.npy, poses.npy, images/MCU_0k/000001.png, masks/MCU_0k/000001.png}. Metres; Rt is
world to camera; pixel centres are at a half, as here. Picture 000001 has the first pose of poses.npy; hand_pose is
relative to the mean pose, and a person has one shape. Both .npy files are pickles of tables, and are read like
MANO's: numbers, and nothing that could run. The studio's light is not told for every camera. Licence: CC BY-NC 4.0,
given out by form.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...hand.mano.unpickle import read_numpy_object
from ...method import Progress, silent
from ...scene import Array, Camera, Frame, Mesh, Observation, Pose, Unknown
from ..capture import Capture
from ..pictures import read_mask, read_picture
from .mano import posed, right_hand
from .place import check_size, lacking, listed, place_of

if TYPE_CHECKING:
    from ...hand.mano import ManoHand

NAME = "palm"
SIZES = ("released",)

_LIGHT = Unknown("studio")
_POSES = {"global_orient": 3, "hand_pose": 45, "transl": 3}


def fits(folder: Path) -> bool:
    """Whether a folder is of this layout: the data set, its folders/, or one subject."""
    return bool(_subjects(folder))


def open_capture(size: str = "released", folder: Path | None = None, progress: Progress = silent) -> PalmCapture:
    """PALM's hands on the user's disk, or as many of them as there are."""
    check_size(NAME, size, SIZES)
    return PalmCapture(place_of(NAME, folder, fits))


class PalmCapture(Capture):
    """Every camera in every pose that has a picture; all are of the segment "scan"."""

    layout = "PALM"

    def __init__(self, folder: Path) -> None:
        self.folder, self.name = folder, NAME
        self._hand, self._why = right_hand()
        self.hand = None if self._hand is None else self._hand.name
        self._places = {place.name: place for place in _subjects(folder)}
        self._digest = hashlib.sha256()
        self._frames = listed(frame for place in self._places.values() for frame in self._subject(place))
        if not self._frames:
            raise InputError(f"{folder} has no pictures; get PALM's images")
        self.digest = self._digest.hexdigest()

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    @property
    def remarks(self) -> tuple[str, ...]:
        return self._why

    def observe(self, frame: Frame) -> Observation:
        place, name = self._places[frame.subject], f"{frame.camera.name}/{frame.pose_name}.png"
        image, alpha = read_picture(place / "images" / name).image, read_mask(place / "masks" / name)
        if alpha.shape != image.shape[:2]:
            raise InputError(f"mask {name} is {alpha.shape[1]}x{alpha.shape[0]}, its picture is not")
        return Observation(image * alpha[..., None], alpha)

    def _subject(self, place: Path) -> Iterator[Frame]:
        cameras, (poses, betas) = _cameras(place / "cameras.npy"), _poses(place / "poses.npy")
        meshes: dict[str, tuple[Pose | None, Mesh | None]] = {}
        for camera in cameras:
            folder = place / "images" / camera.name
            names = sorted(os.listdir(folder)) if folder.is_dir() else []  # noqa: PTH208  (names alone are faster)
            self._digest.update(f"{place.name}/{camera.name} {len(names)}".encode())
            for name in (n.removesuffix(".png") for n in names if n.endswith(".png")):
                if name not in meshes:
                    meshes[name] = self._posed(place, name, poses, betas)
                pose, mesh = meshes[name]
                shape = None if pose is None else betas
                yield Frame(place.name, name, "studio", pose, mesh, camera, _LIGHT, "scan", "full", shape)

    def _posed(self, place: Path, name: str, poses: dict[str, Array], betas: Array) -> tuple[Pose | None, Mesh | None]:
        number = int(name) - 1 if name.isdigit() else -1
        if not 0 <= number < len(poses["transl"]):
            raise InputError(f"{place}: picture {name} has no pose among the {len(poses['transl'])} of poses.npy")
        if self._hand is None:
            return None, None
        pose = Pose.unread(partial(_pose, self._hand, {key: value[number] for key, value in poses.items()}, betas))
        return pose, posed(self._hand, betas, pose)


def _subjects(folder: Path) -> list[Path]:
    for root in (folder, folder / "folders"):
        if not root.is_dir():
            continue
        every = [root, *sorted(p for p in root.iterdir() if p.is_dir())]
        if found := [p for p in every if (p / "cameras.npy").is_file() and (p / "images").is_dir()]:
            return found
    return []


def _cameras(path: Path) -> list[Camera]:
    table = read_numpy_object(path, "camera file")
    try:
        found = []
        for name, said in sorted(table["cameras"].items()):
            size = int(said["width"]), int(said["height"])
            found.append(Camera(name, *size, np.asarray(said["K"], np.float64), np.asarray(said["Rt"], np.float64)[:3]))
        return found
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"camera file {path} has no cameras with K, Rt, width, height; get it anew") from error


def _poses(path: Path) -> tuple[dict[str, Array], Array]:
    if not path.is_file():
        raise lacking(path.parent, path.name)
    table: Any = read_numpy_object(path, "pose file")
    try:
        poses = {name: np.asarray(table[name], np.float64).reshape(-1, width) for name, width in _POSES.items()}
        betas = np.asarray(table["betas"], np.float64).reshape(-1, 10)[0]
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(f"pose file {path} has no {', '.join((*_POSES, 'betas'))}; get it anew") from error
    if len({len(value) for value in poses.values()}) > 1 or not all(
        np.isfinite(v).all() for v in (*poses.values(), betas)
    ):
        raise InputError(f"pose file {path} holds NaN, or not as many of one kind as of the others; get it anew")
    betas.flags.writeable = False
    return poses, betas


def _pose(hand: ManoHand, told: dict[str, Array], betas: Array) -> Pose:
    return hand.pose_of(told["hand_pose"], told["global_orient"], told["transl"], betas, flat_hand_mean=False)
