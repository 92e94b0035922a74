"""An avatar on disk: a folder that is written whole and checked when it is read. It may be a stranger's: no pickles.

avatar.json         what it is: method, preset, settings, version, licence, poses and cameras by name; and the
                    SHA-256 of each other file
repertoire.npz      the arrays of poses, cameras and meshes
prior/              as `Prior.save` wrote it
avatar/             as `Avatar.save` wrote it
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

import numpy as np

from .. import __version__
from ..bench.isolation import isolated
from ..bench.reopening import method_as
from ..data.arrays import read_arrays
from ..errors import Damaged, InputError, StorageError
from ..files import read_json, writing
from ..registry import METHODS
from ..results.schema import Json, Misfit, Rule, plain, read, told
from ..scene import Array, Camera, Mesh, Pose, Topology
from .portrait import Portrait
from .repertoire import Body, Posture, Repertoire

FILE, _ARRAYS = "avatar.json", "repertoire.npz"
FORMAT = "handbench avatar"
SCHEMA = 1
_LIMIT = 4 << 30  # bytes of all files of an avatar
_JSON = 16 << 20
_MOST = 10_000  # files


def _inside(text: str) -> bool:
    path = PurePosixPath(text)
    return 0 < len(text) < 400 and not path.is_absolute() and "\\" not in text and ".." not in path.parts


Inside = Annotated[str, Rule("a path inside of the folder", _inside)]


def is_line(text: str) -> bool:
    """Whether a text can stand in an avatar's record."""
    return 0 < len(text) <= 2000 and text.isprintable()


Line = Annotated[str, Rule("a line of text", is_line)]
Side = Annotated[int, Rule("a size of 1 to 16384 pixels", lambda value: 1 <= value <= 16384)]


@dataclass(frozen=True, slots=True)
class CameraRecord:
    """A camera; its matrices are in the arrays."""

    name: Line = told("its name")
    width: Side = told("pixels across")
    height: Side = told("pixels down")


@dataclass(frozen=True, slots=True)
class PostureRecord:
    """A pose; which of its parts are in the arrays."""

    name: Line = told("its name")
    pose: bool = told("whether joints are told")
    mesh: bool = told("whether a mesh is told")


@dataclass(frozen=True, slots=True)
class BodyRecord:
    """The hand model that poses the subject anew."""

    hand: Line = told("its registered name")
    level: int | None = told("the level of its meshes; null for a method with its own", default=None)


@dataclass(frozen=True, slots=True)
class AvatarRecord:
    """avatar.json."""

    format: str = told(FORMAT)
    schema: int = told("version of the format")
    version: str = told("of handbench that wrote it")
    method: Line = told("the method's registered name")
    title: Line = told("the method's name for readers")
    preset: str = told("the method's preset")
    config: Json = told("every setting that can change a picture")
    subject: Line = told("who it shows")
    source: Line = told("what it was made from")
    licence: Line = told("what must be known before it is given away")
    cameras: tuple[CameraRecord, ...] = told("cameras, in order")
    postures: tuple[PostureRecord, ...] = told("poses, in order")
    views: tuple[tuple[str, ...], ...] = told("pairs of pose and camera that were recorded")
    body: BodyRecord | None = told("null where the hand model is not known")
    files: dict[Inside, str] = told("SHA-256 of each other file")

    def __post_init__(self) -> None:
        if self.format != FORMAT:
            raise Misfit(f"is {json.dumps(self.format)}, not {json.dumps(FORMAT)}", "format")
        if self.schema != SCHEMA:
            raise Misfit(f"is {self.schema}, and this version of handbench reads {SCHEMA}", "schema")
        postures, cameras = ({each.name for each in some} for some in (self.postures, self.cameras))
        if len(postures) < len(self.postures) or len(cameras) < len(self.cameras):
            raise Misfit("have a name twice", "postures" if len(postures) < len(self.postures) else "cameras")
        if not self.views:
            raise Misfit("is empty", "views")
        for place, view in enumerate(self.views):
            if len(view) != 2 or view[0] not in postures or view[1] not in cameras:
                raise Misfit("is no pose and camera of the avatar", f"views[{place}]")


def write_avatar(portrait: Portrait, folder: Path) -> Path:
    """Write an avatar into a folder that is not there yet, or holds an avatar, which it replaces; whole or not at all.

    Raises `Unsupported` for a method whose avatars cannot be kept, and `StorageError` if it cannot be written.
    """
    if folder.exists() and not (folder / FILE).is_file() and (not folder.is_dir() or any(folder.iterdir())):
        raise StorageError(f"{folder} is there and is no avatar; choose another folder with --out")
    part = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    try:
        with writing(folder):
            for name in ("prior", "avatar"):
                (part / name).mkdir(parents=True)
        with writing(folder), isolated():
            portrait.prior.save(part / "prior")
            portrait.avatar.save(part / "avatar")
        with writing(folder):
            np.savez_compressed(part / _ARRAYS, **_arrays(portrait.repertoire))
            record = _record(portrait, {name: _sha256(part / name) for name in sorted(_files(part))})
            (part / FILE).write_text(json.dumps(plain(record), indent=1, allow_nan=False), encoding="utf-8")
            if folder.exists():
                shutil.rmtree(folder)
            part.rename(folder)
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return folder


def read_record(folder: Path) -> AvatarRecord:
    """What an avatar says of itself. Raises `InputError` for a folder that holds none, `Damaged` for a wrong field."""
    if not (folder / FILE).is_file():
        raise InputError(f"{folder} is no avatar (it has no {FILE}); 'handbench personalise' makes one")
    try:
        return read(AvatarRecord, read_json(folder / FILE, _JSON, "avatar"))
    except Misfit as error:
        raise Damaged(f"avatar {folder / FILE} is damaged: {error}; get it again") from error


def read_avatar(folder: Path) -> Portrait:
    """The avatar in a folder, every file of which is what was written.

    Raises `InputError` for a folder without one, of a method that is not installed or now has other settings, and
    `Damaged` for whatever is wrong with it.
    """
    record = read_record(folder)
    _check_files(folder, record)
    entry = METHODS.entry(record.method)
    try:
        method = method_as(entry, record.preset, record.config)
    except InputError as error:
        by = "" if record.version == __version__ else f", made by version {record.version} (this is {__version__})"
        raise InputError(f"avatar {folder}{by} cannot be shown here: {error}; personalise it anew") from error
    with isolated():
        prior = method.load(folder / "prior")
        avatar = prior.restore(folder / "avatar")
    try:
        repertoire = _repertoire(record, read_arrays(folder / _ARRAYS, "avatar"))
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise Damaged(f"avatar {folder / _ARRAYS} is damaged ({error}); get it again") from error
    made = (record.preset, dict(method.config), prior, avatar, repertoire)
    return Portrait(_title(folder), method.info, *made, record.source, record.licence, _sha256(folder / FILE))


def _title(folder: Path) -> str:
    return folder.resolve().name.removesuffix(".avatar")


def _record(portrait: Portrait, files: dict[str, str]) -> AvatarRecord:
    shown = portrait.repertoire
    body = None if shown.body is None else BodyRecord(shown.body.hand, shown.body.level)
    return AvatarRecord(
        FORMAT,
        SCHEMA,
        __version__,
        portrait.info.name,
        portrait.info.title,
        portrait.preset,
        portrait.config,
        shown.subject,
        portrait.source,
        portrait.licence,
        tuple(CameraRecord(name, camera.width, camera.height) for name, camera in shown.cameras.items()),
        tuple(PostureRecord(p.name, p.pose is not None, p.mesh is not None) for p in shown.postures.values()),
        shown.views,
        body,
        files,
    )


def _arrays(shown: Repertoire) -> dict[str, Any]:
    cameras, poses = shown.cameras.values(), [p.pose for p in shown.postures.values() if p.pose is not None]
    meshes = [p.mesh for p in shown.postures.values() if p.mesh is not None]
    found = {"K": np.stack([c.K for c in cameras]), "world_to_camera": np.stack([c.world_to_camera for c in cameras])}
    if poses:
        found |= {name: np.stack([getattr(pose, name) for pose in poses]) for name in _POSE}
    if meshes:
        topology = meshes[0].topology
        if any(mesh.topology.digest != topology.digest for mesh in meshes):
            raise InputError("the meshes of the poses differ in their triangles; give meshes of one topology")
        found |= {"vertices": np.stack([mesh.vertices for mesh in meshes]), "faces": topology.faces}
        if topology.uvs is not None:
            found |= {"uvs": topology.unwrapped[0], "uv_faces": topology.unwrapped[1]}
    if shown.body is not None:
        found["shape"] = shown.body.shape
    return found


_POSE = ("joints", "rotation", "translation")


def _repertoire(record: AvatarRecord, arrays: dict[str, Array]) -> Repertoire:
    cameras = {
        each.name: Camera(each.name, each.width, each.height, K, placed)
        for each, K, placed in zip(record.cameras, arrays["K"], arrays["world_to_camera"], strict=True)
    }
    poses: dict[str, Pose] = {}
    meshes: dict[str, Mesh] = {}
    if posed := [each.name for each in record.postures if each.pose]:
        every = zip(*(arrays[name] for name in _POSE), strict=True)
        poses = {name: Pose(*parts) for name, parts in zip(posed, every, strict=True)}
    if shaped := [each.name for each in record.postures if each.mesh]:
        topology = Topology(arrays["faces"], arrays.get("uvs"), arrays.get("uv_faces"))
        meshes = {name: Mesh(points, topology) for name, points in zip(shaped, arrays["vertices"], strict=True)}
    postures = {each.name: Posture(each.name, poses.get(each.name), meshes.get(each.name)) for each in record.postures}
    body = None if record.body is None else Body(record.body.hand, arrays["shape"], record.body.level)
    views = tuple((view[0], view[1]) for view in record.views)
    return Repertoire(record.subject, postures, cameras, views, body)


def _check_files(folder: Path, record: AvatarRecord) -> None:
    """Raises `Damaged` unless the files are those of the record; no link leads out of the folder."""
    found = {name for name in _files(folder) if name != FILE}
    if odd := sorted(found ^ record.files.keys()):
        why = "is not there" if odd[0] not in found else "is no file of it"
        raise Damaged(f"avatar {folder}: {odd[0]} {why}; get it again")
    if (size := sum((folder / name).stat().st_size for name in found)) > _LIMIT:
        raise InputError(f"avatar {folder} has {size:,} bytes, more than the {_LIMIT:,} that are read")
    for name, digest in record.files.items():
        if _sha256(folder / name) != digest:
            raise Damaged(f"avatar {folder}: {name} is not what was written; get it again")


def _files(folder: Path) -> Iterator[str]:
    """The regular files below a folder. Raises `Damaged` for links, devices and pipes."""
    for count, path in enumerate(sorted(folder.rglob("*"))):
        if path.is_symlink() or not (path.is_file() or path.is_dir()):
            raise Damaged(f"avatar {folder}: {path.relative_to(folder)} is a link or no regular file; remove it")
        if count > _MOST:
            raise Damaged(f"avatar {folder} has more than {_MOST} files; it is no avatar")
        if path.is_file():
            yield path.relative_to(folder).as_posix()


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
