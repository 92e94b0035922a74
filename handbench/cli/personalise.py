"""handbench personalise: an avatar of a person, from their pictures or from a run, that can be kept and shown."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import InputError
from ..terminal import complain, say
from .shared import examples, json_option, preset, seed, tell

if TYPE_CHECKING:
    from ..avatars.portrait import Portrait
    from ..bench.progress import Steps


def add(verbs: Any) -> None:
    personalise = verbs.add_parser(
        "personalise",
        help="make an avatar of a person from a folder of pictures, or of a subject of a run",
    )
    personalise.add_argument("method", help="a name that 'handbench list methods' shows")
    source = personalise.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--from",
        dest="folder",
        type=Path,
        metavar="FOLDER",
        help="pictures with a handbench.toml, or in a published layout",
    )
    source.add_argument("--run", type=Path, metavar="RUN", help="a run folder: its training and its enrolment")
    personalise.add_argument("--out", type=Path, required=True, metavar="AVATAR", help="the folder that the avatar is")
    personalise.add_argument("--subject", metavar="NAME", help="who (default: the only one, or the first of a run)")
    personalise.add_argument("--segment", metavar="NAME", help="which pictures of the folder (default: all)")
    personalise.add_argument("--prior", type=Path, metavar="RUN", help="with --from: the run that trained the method")
    personalise.add_argument("--preset", type=preset, metavar="NAME", help="with --from (default: quick)")
    personalise.add_argument("--seed", type=seed, metavar="N", help="(default: 0, or the first of a run)")
    personalise.add_argument("--protocol", metavar="FILE", help="with --run, where it is no registered one")
    personalise.add_argument("--data", type=Path, metavar="DIR", help="with --run: where captures are kept")
    personalise.add_argument("--licence", metavar="TEXT", help="what must be known before the avatar is given away")
    personalise.add_argument("--device", default="cpu", help="where networks run: cpu (default), cuda, cuda:1, …")
    json_option(personalise)
    examples(
        personalise,
        "personalise uhm --from my-hand --out me.avatar",
        "personalise urhand-phone --from my-scan --prior runs/phone --out me.avatar",
        "personalise urhand --run runs/quick --subject s05 --out s05.avatar",
        below="then: handbench relight me.avatar --light studio.exr --turn-light --out me.mp4",
    )
    personalise.set_defaults(verb=_personalise)


def _personalise(arguments: argparse.Namespace) -> int:
    from ..avatars.folder import is_line, write_avatar
    from ..bench.progress import steps
    from ..device import on_device
    from ..files import check_folder

    _check_company(arguments)
    if not arguments.out.name:
        raise InputError(f"--out {arguments.out} has no name; name the folder that the avatar is to be")
    if arguments.licence is not None and not is_line(arguments.licence):
        raise InputError("--licence is no line of text of at most 2,000 characters; leave line breaks out")
    check_folder(arguments.out, "name another folder with --out")
    with on_device(arguments.device), steps() as told:
        portrait = _from_folder(arguments, told) if arguments.run is None else _from_run(arguments, told)
        write_avatar(portrait, arguments.out)
    shown = portrait.repertoire
    if arguments.json:
        about = {"postures": len(shown.postures), "cameras": len(shown.cameras), "licence": portrait.licence}
        tell({"avatar": str(arguments.out), "method": portrait.info.name, "source": str(portrait.source), **about})
        return 0
    say(f"{portrait.info.title}: {portrait.source}")
    say(f"{len(shown.postures)} poses, {len(shown.cameras)} cameras; licence: {portrait.licence}")
    say(arguments.out)
    return 0


def _from_folder(arguments: argparse.Namespace, told: Steps) -> Portrait:
    from ..avatars.making import from_capture
    from ..data.readers import open_at
    from ..registry import METHODS

    METHODS.entry(arguments.method)
    capture = open_at(arguments.folder)
    for remark in capture.remarks:
        complain(f"{capture.name}: {remark}")
    enrolment = capture.enrolment(arguments.subject, arguments.segment)
    about = (arguments.preset or "quick", arguments.seed or 0, arguments.prior, arguments.licence or "")
    return from_capture(capture, enrolment, arguments.method, told, *about)


def _from_run(arguments: argparse.Namespace, told: Steps) -> Portrait:
    from dataclasses import replace

    from ..avatars.making import from_run

    about = (arguments.subject, told, arguments.seed, arguments.data, arguments.protocol)
    found = from_run(arguments.run, arguments.method, *about)
    return found if arguments.licence is None else replace(found, licence=arguments.licence)


def _check_company(arguments: argparse.Namespace) -> None:
    """Raises `InputError` for an option that means nothing beside the others."""
    apart = {"--from": ("segment", "prior", "preset"), "--run": ("protocol", "data")}
    given = "--run" if arguments.run is not None else "--from"
    for wanted, options in apart.items():
        for option in options:
            if wanted != given and getattr(arguments, option) is not None:
                raise InputError(f"--{option} goes with {wanted}, not with {given}; leave it out")
