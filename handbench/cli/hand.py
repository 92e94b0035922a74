"""handbench hand: poses and textures of one hand model as those of another."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..terminal import say
from .shared import examples, json_option, tell

if TYPE_CHECKING:
    from ..hand import HandModel

_ELSEWHERE = "choose another place with --out"


def add(verbs: Any) -> None:
    hand = verbs.add_parser("hand", help="poses and textures of one hand model as another's")
    kinds = hand.add_subparsers(required=True, metavar="VERB")
    poses = kinds.add_parser("poses", help="convert a .npz of poses; tells how far key points are apart then")
    poses.set_defaults(verb=_poses)
    poses.add_argument(
        "--flat-hand-mean",
        choices=("yes", "no"),
        help="of MANO's poses: yes if they are whole, no if they are relative to the mean pose",
    )
    texture = kinds.add_parser("texture", help="convert a texture; tells how far the surfaces are apart")
    texture.set_defaults(verb=_texture)
    texture.add_argument("--size", type=int, default=1024, metavar="R", help="of the texture made (default: 1024)")
    for verb in (poses, texture):
        verb.add_argument("file", type=Path, help=".npz" if verb is poses else ".png, .jpg, .avif or .exr, square")
        verb.add_argument("--from", dest="source", metavar="HAND", help="the file's (default: the one that is shipped)")
        verb.add_argument(
            "--to", dest="target", required=True, metavar="HAND", help="one that 'handbench list hands' shows"
        )
        verb.add_argument("--out", type=Path, required=True, metavar="FILE", help=".npz" if verb is poses else ".exr")
        json_option(verb)
    examples(poses, "hand poses poses.npz --to mano-right --flat-hand-mean no --out mano.npz")
    examples(texture, "hand texture skin.exr --to mano-right --size 1024 --out mano-skin.exr")


def _hands(arguments: argparse.Namespace) -> tuple[HandModel, HandModel]:
    """The hand model that is converted from, and the one that is converted to."""
    from ..hand import hand_model

    source = hand_model() if arguments.source is None else hand_model(arguments.source)
    return source, hand_model(arguments.target)


def _poses(arguments: argparse.Namespace) -> int:
    import numpy as np

    from ..data.poses import read_poses, write_poses
    from ..files import check_file
    from ..hand.conversion import converted

    check_file(arguments.out, _ELSEWHERE)
    source, target = _hands(arguments)
    flat = None if arguments.flat_hand_mean is None else arguments.flat_hand_mean == "yes"
    shape, made = None, []
    for posed in read_poses(arguments.file, source, flat):
        found = converted(posed.pose, source.neutral() if posed.shape is None else posed.shape, source, target, shape)
        shape = found.shape  # the first pose's: all are of one person
        made.append(found)
    write_poses(arguments.out, [(found.pose, found.shape) for found in made], target, flat)
    left = 1e3 * np.array([found.residual for found in made])
    if arguments.json:
        tell(
            {
                "file": str(arguments.out),
                "poses": len(made),
                "mean_mm": float(left.mean()),
                "most_mm": float(left.max()),
            }
        )
        return 0
    say(f"{len(made)} poses: key points differ by {left.mean():.1f} mm on average, {left.max():.1f} mm at most")
    return 0


def _texture(arguments: argparse.Namespace) -> int:
    import numpy as np

    from ..data.exr import rgb, write_exr
    from ..data.pictures import read_picture
    from ..errors import InputError
    from ..files import check_file
    from ..hand.textures import converted_texture

    check_file(arguments.out, _ELSEWHERE)
    if arguments.out.suffix.lower() != ".exr":
        raise InputError(f"--out is {arguments.out}; a texture is written as .exr, linear")
    if not 1 <= arguments.size <= 8192:
        raise InputError(f"--size is {arguments.size}; give 1 to 8192")
    source, target = _hands(arguments)
    texture = np.moveaxis(read_picture(arguments.file).image, -1, 0)
    found = converted_texture(texture, source, target, arguments.size)
    write_exr(arguments.out, rgb(np.moveaxis(found.texture, 0, -1), dtype=np.float32))
    uvs = target.topology(min(1, target.levels)).digest
    if arguments.json:
        tell({"file": str(arguments.out), "mean_mm": 1e3 * float(found.distance.mean()), "uvs": uvs})
        return 0
    say(f"{arguments.out}: {found}; UVs {uvs[:16]}")
    return 0
