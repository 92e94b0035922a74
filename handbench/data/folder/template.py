"""A handbench.toml for the pictures that a folder has, to be completed by whoever took them."""

from __future__ import annotations

import math
import zipfile
from collections import Counter
from pathlib import Path

from ...errors import InputError
from ...files import whole
from ...hand.known import SHIPPED
from ...registry import HANDS
from ..codes import opened_codes
from ..pictures import SUFFIXES
from ..picturesize import has_alpha, picture_size
from .manifest import FILE

_MASKS, _DEPTHS = ("masks", "mask"), ("depth", "depths")
_PHONE = 26.0  # mm: the usual main camera of a phone, as on 35 mm film
_FILM = (36.0, 24.0)
_FOCAL_35MM = 0xA405  # Exif


def write_template(folder: Path) -> Path:
    """Write a handbench.toml into a folder with pictures, by what is there.

    Raises `InputError` for a folder without pictures, or that has the file already.
    """
    if not folder.is_dir():
        raise InputError(f"folder {folder} does not exist; give a folder with pictures")
    path = folder / FILE
    if path.exists():
        raise InputError(f"{path} is there already; edit it, or remove it first")
    text = template(folder)
    with whole(path, "give a folder that can be written") as part:
        part.write_text(text, encoding="utf-8")
    return path


def template(folder: Path) -> str:
    """The text of a handbench.toml for what a folder has."""
    images, first = _pictures(folder)
    lines = ['format = "handbench folder"', "version = 1", "", "# Where pictures are; {pose}, {camera}, {lighting},"]
    lines += ["# {subject} and {segment} stand for what their paths tell.", f'images = "{images}"']
    if not first.name.lower().endswith((".exr", ".npy")):
        lines += ['colour = "srgb"               # what PNG, JPEG and AVIF hold: "srgb" or "linear"']
    lines += ['subject = "me"', 'lighting = "room"             # a name for the light, which need not be known']
    lines += ["sequence = false              # true: the poses, by name, are moments of one movement"]
    lines += _beside(folder, images, first)
    lines += ["", 'units = "metres"              # of cameras, meshes and poses: metres, centimetres, millimetres']
    lines += _cameras(folder, first)
    lines += ["", "# A light that is known: direction and irradiance, position and intensity, or an environment map."]
    lines += ["# [[light]]", '# name = "room"', '# environment = "room.exr"']
    return "\n".join(lines) + "\n"


def _pictures(folder: Path) -> tuple[str, Path]:
    """The pattern of most pictures of a folder, and the first that fits it."""
    beside = {*_MASKS, *_DEPTHS, "keypoints", "meshes", "poses", "environments", "maps", "sparse"}
    found: Counter[tuple[str, str]] = Counter()
    first: dict[tuple[str, str], Path] = {}
    for path in sorted(folder.glob("*")) + sorted(folder.glob("*/*")) + sorted(folder.glob("*/*/*")):
        parts = path.relative_to(folder).parts
        if path.suffix.lower() in SUFFIXES and path.is_file() and parts[0] not in beside and parts[0][0] != ".":
            place = "/".join(parts[:-1]) if len(parts) < 3 else f"{parts[0]}/{{camera}}"
            key = place, path.suffix
            found[key] += 1
            first.setdefault(key, path)
    if not found:
        raise InputError(f"folder {folder} holds no pictures; put some into it, as images/0001.png")
    key = found.most_common(1)[0][0]
    place, suffix = key
    return (f"{place}/" if place else "") + "{pose}" + suffix, first[key]


def _beside(folder: Path, images: str, first: Path) -> list[str]:
    """Lines for what lies beside the pictures."""
    tail = "{camera}/{pose}" if "{camera}" in images else "{pose}"
    lines = []
    for key, names in (("masks", _MASKS), ("depth", _DEPTHS), ("keypoints", ("keypoints",))):
        for name in names:
            if (suffix := _suffix(folder / name)) is not None:
                lines.append(f'{key} = "{name}/{tail}{suffix}"')
                if key == "depth":
                    lines.append("depth_unit = 0.001            # metres in one step of a PNG")
    if not any(line.startswith("masks") for line in lines) and not has_alpha(first):
        lines.append('# masks = "masks/{pose}.png"  # white where the hand is; most methods need them')
    if (suffix := _suffix(folder / "meshes")) is not None:
        lines.append(f'meshes = "meshes/{{pose}}{suffix}"')
    if _suffix(folder / "poses") == ".npz":
        lines += ['poses = "poses/{pose}.npz"', *_hand(folder / "poses")]
    return ["", *lines] if lines else []


def _hand(poses: Path) -> list[str]:
    first = min(poses.rglob("*.npz"))
    try:
        with zipfile.ZipFile(first) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, OSError, NotImplementedError) as error:
        raise InputError(f"pose file {first} is damaged or no .npz ({error}); write it anew") from error
    if "hand_pose.npy" not in names:
        hand = f'hand = "{SHIPPED}"'
        return [f"{hand:<30}# whose poses these are: {', '.join(HANDS.entries())}"]
    return [
        'hand = "mano-right"           # or mano-left',
        "# Say which it is: true if hand_pose is whole, false if it is relative to MANO's mean pose",
        "# flat_hand_mean = ",
    ]


def _suffix(folder: Path) -> str | None:
    """The suffix of most files in a folder, at most two folders down; None if there are none."""
    found = Counter(p.suffix for p in (*folder.glob("*"), *folder.glob("*/*")) if p.is_file() and p.name[0] != ".")
    return found.most_common(1)[0][0] if found else None


def _cameras(folder: Path, first: Path) -> list[str]:
    for name in ("transforms.json", "colmap/transforms.json"):
        if (folder / name).is_file():
            return ['up = "z"                      # which axis is up in these cameras: y, z or -y', "",
                    "[cameras]", f'file = "{name}"']  # fmt: skip
    for name in ("sparse/0", "sparse", "colmap/sparse/0"):
        if any((folder / name / f"cameras.{kind}").is_file() for kind in ("txt", "bin")):
            lines = ["# COLMAP does not know how large things are: scale its model before, with model_aligner"]
            return ['up = "-y"                     # which axis is up in these cameras: y, z or -y', "",
                    *lines, "[cameras]", f'colmap = "{name}"']  # fmt: skip
    width, height = picture_size(first)
    focal, told = _focal(first)
    film = _FILM if width >= height else _FILM[::-1]
    angle = math.degrees(2 * math.atan(0.5 * film[0] / focal))
    why = "as Exif tells" if told else "of a usual phone: say that of yours"
    return ["", "[cameras]", f"field_of_view = {angle:.1f}          # degrees across the picture, {why}"]


def _focal(path: Path) -> tuple[float, bool]:
    """The focal length as on 35 mm film, and whether the picture tells it."""
    if path.suffix.lower() in (".exr", ".npy"):
        return _PHONE, False
    with opened_codes(path) as image:
        exif = image.getexif()
        told = exif.get_ifd(0x8769).get(_FOCAL_35MM) or exif.get(_FOCAL_35MM)
    return (float(told), True) if isinstance(told, int | float) and told > 0 else (_PHONE, False)
