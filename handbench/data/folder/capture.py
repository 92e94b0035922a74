"""The reader of a plain folder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...files import read_json
from ...hand import HandModel, hand_model
from ...recording import Need
from ...scene import Array, Frame, Mesh, Observation
from ..arrays import read_array
from ..capture import Capture
from ..exr import read_exr
from ..meshfile import read_mesh
from ..pictures import Stated, read_mask, read_picture
from ..picturesize import has_alpha
from ..poses import PoseAndShape, read_poses, turned
from .cameras import Cameras
from .lights import Lights
from .manifest import FolderManifest
from .pattern import inside


class Folder(Capture):
    """Pictures with a handbench.toml. Frames whose picture has no camera in the calibration are left out."""

    layout = "a plain folder"

    def __init__(self, folder: Path, manifest: FolderManifest) -> None:
        self.folder, self._manifest = folder, manifest
        self.name, self.hand = manifest.name, manifest.hand
        self._model: HandModel | None = None if manifest.hand is None else hand_model(manifest.hand)
        self._pictures: dict[str, str] = {}  # by frame key
        self._parts: dict[str, dict[str, str]] = {}  # by frame key: which file holds each part
        self._poses: dict[str, PoseAndShape] = {}  # by file
        self._meshes: dict[str, Mesh] = {}  # by pose key
        self._unplaced = 0
        self._frames = tuple(self._build())

    def frames(self) -> tuple[Frame, ...]:
        return self._frames

    @cached_property
    def digest(self) -> str:  # type: ignore[override]
        """Of the content of every file that the frames are made of."""
        said = json.loads(json.dumps({**vars(self._manifest), "name": None}, default=str))
        total = hashlib.sha256(json.dumps(said, sort_keys=True).encode())
        named = {file for parts in self._parts.values() for file in parts.values()}
        extra = [self._manifest.cameras.get("file"), *(light.get("environment") for light in self._manifest.lights)]
        model = self._manifest.cameras.get("colmap")
        if model is not None:
            extra += [f"{model}/{path.name}" for path in (self.folder / model).iterdir() if path.is_file()]
        for name in sorted({*named, *self._pictures.values(), *filter(None, extra)}):
            with (self.folder / name).open("rb") as file:
                total.update(f"\0{name}\0{hashlib.file_digest(file, 'sha256').hexdigest()}".encode())
        return total.hexdigest()

    @property
    def linear_codes(self) -> bool:
        """Whether pictures of whole numbers are said to be linear."""
        coded = any(not name.lower().endswith((".exr", ".npy")) for name in self._pictures.values())
        return coded and self._manifest.colour == "linear"

    @property
    def offers(self) -> frozenset[Need]:
        parts: dict[Need, bool] = {
            "alpha": "masks" in self._manifest.parts or self._all_have_alpha,
            "keypoints": "keypoints" in self._manifest.parts,
            "depth": "depth" in self._manifest.parts,
        }
        return super().offers - {"alpha"} | {part for part, there in parts.items() if there}

    @property
    def remarks(self) -> tuple[str, ...]:
        if not self._unplaced:
            return ()
        return (f"{self._unplaced} pictures have no camera in the calibration and are left out",)

    def observe(self, frame: Frame) -> Observation:
        parts = self._parts[frame.key]
        picture = read_picture(self._file(self._pictures[frame.key]), self._stated(self._pictures[frame.key]))
        image, alpha = picture.image, picture.alpha
        if "masks" in parts:
            mask = read_mask(self._file(parts["masks"]))
            if mask.shape != image.shape[:2]:
                size = f"{mask.shape[1]}x{mask.shape[0]}"
                raise InputError(
                    f"mask {parts['masks']} is {size}, its picture {image.shape[1]}x{image.shape[0]}; make them equal"
                )
            image = image * mask[..., None]
            alpha = mask if alpha is None else alpha * mask
        keypoints = _keypoints(self._file(parts["keypoints"])) if "keypoints" in parts else None
        depth = self._depth(parts["depth"], alpha) if "depth" in parts else None
        return Observation(image, alpha, keypoints=keypoints, depth=depth)

    # -- how frames are made ----------------------------------------------------------------------------------------

    def _build(self) -> list[Frame]:
        manifest, owner = self._manifest, f"folder {self.folder}"
        found = list(manifest.images.files(self.folder))
        if not found:
            raise InputError(f"{owner} has no picture that fits images = {manifest.images.text!r}; check the pattern")
        cameras, lights = Cameras(self.folder, manifest), Lights(self.folder, manifest)
        moments: dict[str, dict[str, int]] = {}
        frames = []
        for picture, named in found:
            told = {**manifest.constants, **named}
            camera = cameras.of(picture, told["camera"])
            if camera is None:
                self._unplaced += 1
                continue
            light, kind = lights.of(told["lighting"])
            moment = moments.setdefault(told["subject"], {}) if manifest.sequence else None
            posed = self._posed(told)
            frame = Frame(
                told["subject"],
                told["pose"],
                told["lighting"],
                None if posed is None else posed.pose,
                self._mesh(told, posed),
                camera,
                light,
                told["segment"],
                kind,
                None if posed is None else posed.shape,
                None if moment is None else moment.setdefault(told["pose"], len(moment)),
            )
            if frame.key in self._pictures:
                raise InputError(
                    f"{owner}: {picture} and {self._pictures[frame.key]} are both {frame.key}; give images more fields"
                )
            self._pictures[frame.key] = picture
            self._parts[frame.key] = {name: self._there(name, told, picture) for name in manifest.parts}
            frames.append(frame)
        if not frames:
            raise InputError(f"{owner}: none of its pictures is in the calibration; check the names in it")
        lights.check_used(self.folder)
        return frames

    def _there(self, part: str, told: dict[str, str], picture: str) -> str:
        path = self._manifest.parts[part].path(told)
        if not inside(self.folder, path).is_file():
            raise InputError(f"folder {self.folder}: {picture} has no {path}; add it, or leave out {part}")
        return path

    def _posed(self, told: dict[str, str]) -> PoseAndShape | None:
        if "poses" not in self._manifest.parts or self._model is None:
            return None
        path = self._there("poses", told, self._manifest.images.path(told))
        if path not in self._poses:
            poses = read_poses(self._file(path), self._model, self._manifest.flat_hand_mean, self._manifest.unit)
            if len(poses) > 1:
                raise InputError(f"pose file {path} holds {len(poses)} poses; give each pose a file of its own")
            self._poses[path] = PoseAndShape(turned(poses[0].pose, self._manifest.up), poses[0].shape)
        return self._poses[path]

    def _mesh(self, told: dict[str, str], posed: PoseAndShape | None) -> Mesh | None:
        key = f"{told['subject']}/{told['pose']}"
        if key not in self._meshes:
            made = self._new_mesh(told, posed)
            if made is None:
                return None
            self._meshes[key] = made
        return self._meshes[key]

    def _new_mesh(self, told: dict[str, str], posed: PoseAndShape | None) -> Mesh | None:
        if self._manifest.model_meshes:
            assert posed is not None and self._model is not None
            model, shape = self._model, posed.shape
            if shape is None:
                raise InputError(f"folder {self.folder}: meshes from poses need a shape in every pose file; add it")
            level = min(1, model.levels)
            return Mesh.unread(lambda: model.mesh(shape, posed.pose, level).vertices, model.topology(level))
        if "meshes" not in self._manifest.parts:
            return None
        path = self._there("meshes", told, self._manifest.images.path(told))
        if not self._meshes:
            return self._read_mesh(path)
        shared = next(iter(self._meshes.values())).topology
        read: Callable[[], Array] = partial(self._vertices, path, shared.digest)
        return Mesh.unread(read, shared)

    def _vertices(self, path: str, digest: str) -> Array:
        mesh = self._read_mesh(path)
        if mesh.topology.digest != digest:
            raise InputError(f"mesh {path} has other faces or UVs than the folder's first; give all one topology")
        return mesh.vertices

    def _read_mesh(self, path: str) -> Mesh:
        mesh = read_mesh(self._file(path), self._manifest.unit)
        return Mesh(mesh.vertices @ self._manifest.up.T, mesh.topology)

    # -- files ------------------------------------------------------------------------------------------------------

    def _file(self, path: str) -> Path:
        return inside(self.folder, path)

    def _stated(self, picture: str) -> Stated:
        codes = not picture.lower().endswith((".exr", ".npy"))
        # for sRGB the file's own statement counts, so that a profile of other colours is refused by name
        return Stated(encoding="linear" if codes and self._manifest.colour == "linear" else "auto")

    @cached_property
    def _all_have_alpha(self) -> bool:
        return all(has_alpha(self._file(name)) for name in self._pictures.values())

    def _depth(self, path: str, alpha: Array | None) -> Array:
        file = self._file(path)
        if file.suffix.lower() == ".exr":
            channels = read_exr(file, what="depth map", finite=False)
            found = channels.get("Z", channels.get("Y", channels.get("R")))
            if found is None:
                raise InputError(f"depth map {path} has none of the channels Z, Y, R")
            metres: Array = found * self._manifest.unit
        elif file.suffix.lower() == ".npy":
            metres = read_array(file, "depth map").astype(np.float32) * self._manifest.unit
        else:
            from ..codes import read_codes

            metres = read_codes(file, "depth map", said=True).values.astype(np.float32) * self._manifest.depth_unit
        if metres.ndim != 2:
            raise InputError(f"depth map {path} has shape {metres.shape}, expected (H, W)")
        metres = np.where(np.isfinite(metres), metres, 0.0).astype(np.float32)
        return metres if alpha is None else metres * (alpha > 0)


def _keypoints(path: Path) -> Array:
    """Key points (21, 3): x and y in pixels from the upper left corner, and how sure they are."""
    if path.suffix.lower() == ".json":
        try:
            found = np.array(read_json(path, what="key point file"), np.float64)
        except (ValueError, TypeError) as error:
            raise InputError(f"key point file {path} is no list of 21 points; give [[x, y], …]") from error
    else:
        found = read_array(path, "key point file").astype(np.float64)
    if found.shape not in ((21, 2), (21, 3)):
        raise InputError(f"key point file {path} has shape {found.shape}; expected (21, 2) or (21, 3), wrist first")
    return found if found.shape[1] == 3 else np.c_[found, np.ones(21)]
