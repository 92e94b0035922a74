"""Goliath's hands (Martinez et al., 2024), URHand's data: a stage whose lights shine five at a time, or all.

Layout of a capture m--…--Hands--right: camera_calibration.json (KRT: K and T are stored transposed, millimetres),
frame_splits_list.csv, image/camID.zip with camID/000000.avif, segmentation_fgbg/camID.zip with .png,
kinematic_tracking/registration_vertices.zip with .ply, lights/light_pattern_metadata.json,
lights/light_pattern_per_frame.json. Pictures have half the calibrated size; their codes are linear, with a black
level of (2, 1, 2) and a white balance of (1.4, 1.1, 1.6) to be applied. Masks and meshes are of fully lit frames
alone. Light durations over 5555 are brightness: here so much irradiance at the stage's centre. Licence: CC BY-NC
4.0.
"""

from __future__ import annotations

import csv
import hashlib
import io
import re
from bisect import bisect_left
from collections.abc import Iterator
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...files import read_json, read_text
from ...method import Progress, silent
from ...recording import Need
from ...scene import Array, Camera, Frame, FrameKind, Group, Light, Mesh, Observation, Point, Pose, Topology
from ..capture import Capture
from ..meshfile import read_mesh
from ..meshfile.ply import read_vertices
from .masked import covered
from .place import check_size, lacking, listed, place_of
from .zipped import Zips

NAME = "goliath"
SIZES = ("released",)
BLACK, BALANCE = np.array([2.0, 1.0, 2.0]), np.array([1.4, 1.1, 1.6])
UNIT_DURATION = 5555.0
GROUP = 5
"""Lights of a partially lit frame; frames of other numbers are left out, as by the authors' reader."""

_APART = 12  # frames: how far the registrations may be between which a mesh is interpolated
_HANDS = re.compile(r".*--Hands--(left|right)")
_LIMIT = 256 << 20


def fits(folder: Path) -> bool:
    """Whether a folder is one capture of this layout, or holds some."""
    return bool(_captures(folder))


def open_capture(size: str = "released", folder: Path | None = None, progress: Progress = silent) -> GoliathCapture:
    """Goliath's hand captures on the user's disk: one, or a folder of several."""
    check_size(NAME, size, SIZES)
    return GoliathCapture(place_of(NAME, folder, fits))


class GoliathCapture(Capture):
    """Hands on a light stage. Segments are the authors' "train" and "test", kinds are "full" and "group".

    Meshes need faces and UVs: a `topology.obj` beside the captures, whose vertices are in the registration's order.
    Those of partially lit frames are interpolated between the registrations before and after.
    """

    layout = "Goliath hands"

    def __init__(self, folder: Path) -> None:
        self.folder, self.name, self.hand = folder, NAME, None
        self._zips = Zips()
        self._digest = hashlib.sha256()
        self._stages = {stage.subject: stage for stage in (_Stage(p, self._zips) for p in _captures(folder))}
        self._frames = listed(frame for stage in self._stages.values() for frame in stage.frames(self._digest))
        if not self._frames:
            raise InputError(f"{folder} has no frames with pictures; get its image/cam….zip files")
        self.digest = self._digest.hexdigest()

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    @property
    def offers(self) -> frozenset[Need]:
        found = super().offers
        whole = all(stage.topology is not None or not stage.partial for stage in self._stages.values())
        return found if whole else found - {"alpha"}

    @property
    def remarks(self) -> tuple[str, ...]:
        return tuple(remark for stage in self._stages.values() for remark in stage.remarks)

    def observe(self, frame: Frame) -> Observation:
        stage = self._stages[frame.subject]
        codes = self._zips.picture(stage.folder / "image" / f"{frame.camera.name}.zip", _member(frame, "avif"))
        image = np.clip((codes[..., :3].astype(np.float32) - BLACK) * BALANCE / 255.0, 0.0, 1.0).astype(np.float32)
        alpha = stage.mask(frame, image.shape[:2])
        return Observation(image if alpha is None else image * alpha[..., None], alpha)


class _Stage:
    """One capture: what its frames share."""

    def __init__(self, folder: Path, zips: Zips) -> None:
        self.folder, self._zips = folder, zips
        parts = folder.name.split("--")
        self.subject = f"{parts[3]}-{parts[-1]}" if len(parts) > 4 else folder.name
        self.remarks: list[str] = []
        self.topology = self._read_topology()
        self.partial = False
        self._vertices = lru_cache(4)(self._read_vertices)

    def frames(self, digest: Any) -> Iterator[Frame]:
        splits = self._splits()
        patterns = self._patterns()
        lights = self._lights()
        cameras = self._cameras()
        lit = [number for number in splits if patterns.get(number) == 0]
        self._registered = sorted(lit)
        digest.update(f"{self.folder.name} {len(splits)} {[c.name for c in cameras]}".encode())
        without, posed = 0, (self.folder / "kinematic_tracking" / "pose.zip").is_file()
        for number, split in splits.items() if cameras else ():
            pattern = patterns.get(number)
            if pattern is None or pattern not in lights:
                continue
            light, kind = lights[pattern]
            mesh = self._mesh(number)
            if kind != "full" and mesh is None and self.topology is not None:
                without += 1
                continue
            self.partial |= kind != "full"
            pose = Pose.unread(partial(self._read_pose, number)) if posed else None
            name, lighting = f"{number:06d}", f"pattern-{pattern}" if kind != "full" else "full"
            first = Frame(self.subject, name, lighting, pose, mesh, cameras[0], light, split, kind)
            yield from (first.seen_by(camera) for camera in cameras)
        if without:
            self.remarks.append(f"{self.subject}: {without} partially lit frames are far from a registration, left out")

    def mask(self, frame: Frame, size: tuple[int, int]) -> Array | None:
        """The recorded mask of a fully lit frame; of others what the mesh covers."""
        path = self.folder / "segmentation_fgbg" / f"{frame.camera.name}.zip"
        if frame.kind == "full" and path.is_file():
            codes = self._zips.picture(path, _member(frame, "png"))
            mask = (codes if codes.ndim == 2 else codes.max(axis=-1)) != 0  # any value but 0 is the hand
            step = size[0] // mask.shape[0] if mask.shape[0] else 1
            if step > 1:  # some are stored at half the picture's size
                mask = mask.repeat(step, axis=0).repeat(step, axis=1)
            return mask.astype(np.float32)
        return None if frame.mesh is None else covered(frame.mesh, frame.camera)

    # -- meshes -----------------------------------------------------------------------------------------------------

    def _mesh(self, number: int) -> Mesh | None:
        if self.topology is None:
            return None
        at = bisect_left(self._registered, number)
        if at < len(self._registered) and self._registered[at] == number:
            return Mesh.unread(partial(self._between, number, number, 0.0), self.topology)
        if not 0 < at < len(self._registered):
            return None
        before, after = self._registered[at - 1], self._registered[at]
        if after - before > _APART:
            return None
        return Mesh.unread(partial(self._between, before, after, (number - before) / (after - before)), self.topology)

    def _between(self, before: int, after: int, share: float) -> Array:
        first = self._vertices(before)
        return first.copy() if share == 0 else (1 - share) * first + share * self._vertices(after)

    def _read_vertices(self, number: int) -> Array:
        path = self.folder / "kinematic_tracking" / "registration_vertices.zip"
        content = self._zips.read(path, f"registration_vertices/{number:06d}.ply")
        try:
            return 0.001 * read_vertices(content)
        except (InputError, ValueError, KeyError, IndexError) as error:
            raise InputError(f"{path}: registration {number:06d} cannot be read ({error}); get it anew") from error

    def _read_pose(self, number: int) -> Pose:
        """The rig's numbers: where it is, in millimetres, then its angles, here three in a row. The rig itself is none
        of the hand models that are known, so they say how a pose differs from another and no more."""
        path = self.folder / "kinematic_tracking" / "pose.zip"
        try:
            told = np.array(self._zips.read(path, f"pose/{number:06d}.txt").decode("ascii").split(), np.float64)
        except ValueError as error:
            raise InputError(f"{path}: pose {number:06d} is no list of numbers; get it anew") from error
        if len(told) < 4:
            raise InputError(f"{path}: pose {number:06d} has {len(told)} numbers; get it anew")
        angles = np.pad(told[3:], (0, -(len(told) - 3) % 3))
        return Pose(angles.reshape(-1, 3), np.zeros(3), 0.001 * told[:3])

    def _read_topology(self) -> Topology | None:
        for place in (self.folder, self.folder.parent):
            if (place / "topology.obj").is_file():
                return read_mesh(place / "topology.obj").topology
        self.remarks.append(
            f"{self.subject}: meshes are not there: put the faces and UVs of the authors' shared assets beside them "
            "as topology.obj"
        )
        return None

    # -- what the files say -----------------------------------------------------------------------------------------

    def _splits(self) -> dict[int, str]:
        text = read_text(self.folder / "frame_splits_list.csv", _LIMIT, "frame list")
        try:
            return {int(row["frame"]): row["split"].strip() for row in csv.DictReader(io.StringIO(text))}
        except (KeyError, ValueError, TypeError, AttributeError) as error:
            raise InputError(f"{self.folder}/frame_splits_list.csv has no columns frame, split; get it anew") from error

    def _patterns(self) -> dict[int, int]:
        path = self.folder / "lights" / "light_pattern_per_frame.json"
        try:
            return {int(frame): int(pattern) for frame, pattern in read_json(path, _LIMIT, "light file")}
        except (TypeError, ValueError) as error:
            raise InputError(f"light file {path} is no list of frame and pattern; get it anew") from error

    def _lights(self) -> dict[int, tuple[Light, FrameKind]]:
        path = self.folder / "lights" / "light_pattern_metadata.json"
        table = read_json(path, _LIMIT, "light file")
        try:
            positions = 0.001 * np.array(table["light_positions"], np.float64).reshape(-1, 3)
            found: dict[int, tuple[Light, FrameKind]] = {}
            for number, pattern in enumerate(table["light_patterns"]):
                lit = pattern["light_index_durations"]
                if number and len(lit) != GROUP:
                    continue
                members = []
                for index, duration in lit:
                    at = positions[int(index)]
                    power = duration / UNIT_DURATION * float(at @ at)
                    members.append(Point(at, np.full(3, power)))
                found[number] = Group(tuple(members)), "group" if number else "full"
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise InputError(f"light file {path} has no positions and patterns ({error}); get it anew") from error
        return found

    def _cameras(self) -> list[Camera]:
        path = self.folder / "camera_calibration.json"
        images = self.folder / "image"
        if not images.is_dir():
            raise lacking(self.folder, "image/")
        there = {p.stem for p in images.iterdir() if p.suffix == ".zip"}
        table = read_json(path, _LIMIT, "camera file")
        try:
            listed = {f"cam{entry['cameraId']}": (entry["K"], entry["T"]) for entry in table["KRT"]}
            named = [name for name in listed if name in there]
            if missing := len(listed) - len(named):
                self.remarks.append(
                    f"{self.subject}: {missing} of {len(listed)} cameras have no pictures and are left out"
                )
            if not named:
                return []
            size = self._size(images / f"{named[0]}.zip")
            return [_camera(name, *listed[name], size) for name in named]
        except InputError:  # of the pictures, or of a camera by its name
            raise
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"camera file {path} has no KRT with cameraId, K and T; get it anew") from error

    def _size(self, path: Path) -> tuple[int, int]:
        """Width and height of the pictures, by the first of a camera."""
        height, width = self._zips.picture(path, self._zips.first(path, ".avif")).shape[:2]
        return width, height


def _camera(name: str, transposed_K: Any, transposed_T: Any, size: tuple[int, int]) -> Camera:
    """Half the calibrated size: a pixel's centre c counted from 0 comes to (c + 1/2) / 2 counted from 1/2."""
    K = np.array(transposed_K, np.float64).T.copy()
    K[:2, :2] /= 2.0
    K[:2, 2] = (K[:2, 2] + 0.5) / 2.0
    placed = np.array(transposed_T, np.float64).T[:3, :4].copy()
    placed[:, 3] *= 0.001
    return Camera(name, *size, K, placed)


def _member(frame: Frame, suffix: str) -> str:
    return f"{frame.camera.name}/{frame.pose_name}.{suffix}"


def _captures(folder: Path) -> list[Path]:
    every = [folder, *sorted(p for p in folder.iterdir() if p.is_dir())] if folder.is_dir() else []
    return [p for p in every if _HANDS.fullmatch(p.name) and (p / "camera_calibration.json").is_file()]
