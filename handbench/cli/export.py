"""handbench export: an avatar's surface and reflectance for renderers elsewhere."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..terminal import complain, say
from .shared import examples, json_option, tell


def add(verbs: Any) -> None:
    export = verbs.add_parser(
        "export", help="bake an avatar in a pose into a glTF asset: mesh, albedo, roughness and normal maps"
    )
    export.add_argument("avatar", type=Path, help="what 'handbench personalise' wrote")
    export.add_argument("--pose", default="", metavar="NAME", help="a recorded pose (default: the first)")
    export.add_argument("--out", type=Path, required=True, metavar="FILE", help="a .glb")
    json_option(export)
    examples(export, "export me.avatar --out me.glb", "export me.avatar --pose pose-2 --out me.glb --json")
    export.set_defaults(verb=_export)


def _export(arguments: argparse.Namespace) -> int:
    from ..avatars.folder import read_avatar
    from ..avatars.gltf import write_glb
    from ..files import check_file

    if arguments.out.suffix.lower() != ".glb":
        raise InputError(f"--out {arguments.out} is no .glb; binary glTF is what is written")
    check_file(arguments.out)
    portrait = read_avatar(arguments.avatar)
    shown = portrait.repertoire
    posture = shown.posture(arguments.pose or shown.views[0][0])
    baked = portrait.avatar.baked(shown.viewpoint(posture, shown.camera_of(posture.name)))
    for remark in write_glb(arguments.out, baked, portrait.name, portrait.licence):
        complain(remark)
    size = len(baked.albedo)
    if arguments.json:
        tell({"file": str(arguments.out), "pose": posture.name, "vertices": len(baked.mesh.vertices), "texture": size})
        return 0
    say(f"{portrait.info.title}, pose {posture.name}: {len(baked.mesh.vertices)} vertices, textures of {size} x {size}")
    say(arguments.out)
    return 0
