"""handbench data: make, show and check captures."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any

from ..terminal import say
from .shared import cores, examples, json_option, tell

_MOST = 4  # processes of their own accord: each takes 1 to 2 GB
_READ = 500  # frames of captures that may have a million
_ELSEWHERE = "choose another place with --out"


def add(verbs: Any) -> None:
    data = verbs.add_parser("data", help="make, show and check captures").add_subparsers(required=True, metavar="VERB")
    make = data.add_parser("make", help="generate what is missing of a capture")
    make.set_defaults(verb=_data_make, resumes=True)
    make.add_argument(
        "--processes", type=cores, metavar="N", help=f"that share the work here (default: the cores, {_MOST} at most)"
    )
    make.add_argument("--shard", metavar="I/N", help="only this part of the poses, for arrays of jobs on one folder")
    make.add_argument(
        "--executor", default="local", metavar="NAME", help="local (default), or ray: the nodes of a cluster"
    )
    make.add_argument(
        "--cpus", type=cores, metavar="N", help="with ray, cores for each task (default: the smallest node's)"
    )
    show = data.add_parser("show", help="summarise a capture and draw a contact sheet")
    show.add_argument("--out", type=Path, metavar="PNG", help="the picture (default: CAPTURE.png)")
    show.set_defaults(verb=_data_show)
    check = data.add_parser("check", help="read every frame once and list what is wrong; exit code 2 if anything is")
    check.add_argument("--out", type=Path, metavar="PNG", help="a sheet of what is told, drawn over the pictures")
    check.add_argument(
        "--frames",
        type=cores,
        metavar="N",
        help=f"read so many, spread over it (default: all, {_READ} of others' captures)",
    )
    check.set_defaults(verb=_data_check)
    template = data.add_parser("template", help="write a handbench.toml for a folder of your own pictures")
    template.add_argument("place", type=Path, metavar="FOLDER", help="a folder with pictures")
    template.set_defaults(verb=_data_template)
    for verb in (make, show, check):
        more = "" if verb is make else ", or a folder of your own or of a published capture"
        verb.add_argument("capture", help=f"a name that 'handbench list captures' shows{more}")
        verb.add_argument(
            "--size",
            metavar="SIZE",
            help="mini, quick (default), dense, standard or full; released (default) of captures that others publish",
        )
        verb.add_argument("--data", "--folder", dest="folder", type=Path, metavar="DIR", help="where captures are kept")
    for verb in (make, show, check, template):
        json_option(verb)
    examples(make, "data make openstage --size quick", "data make openstage --size standard --shard 1/8 --data /shared")
    examples(show, "data show openstage --size mini")
    examples(check, "data check openstage --size mini --json", "data check ./my-hand  # and a sheet, my-hand-check.png")
    examples(template, "data template my-hand")


def _data_make(arguments: argparse.Namespace) -> int:
    from ..bench.making import make_capture
    from ..bench.progress import steps
    from ..shards import Shard

    shard = None if arguments.shard is None else Shard.parse(arguments.shard)
    processes = arguments.processes or min(_MOST, os.cpu_count() or 1)
    name, size, folder = arguments.capture, _size(arguments), arguments.folder
    with steps() as told:
        left = make_capture(name, size, folder, told, shard, arguments.executor, arguments.cpus, processes)
    if arguments.json:
        tell({"missing": sorted(map(str, left))} if left else _facts(_capture(arguments)))
        return 0
    if left:
        say(f"shard {shard}: made; not there yet, of other shards: {len(left)} poses")
        say("the capture is finished by the shard that finishes last, or by the same command without --shard")
        return 0
    capture = _capture(arguments)
    say(f"{capture.name}: {len(capture.frames())} frames, digest {capture.digest[:16]}")
    return 0


def _data_show(arguments: argparse.Namespace) -> int:
    from ..data.contactsheet import summary, write_contact_sheet
    from ..files import check_file

    if arguments.out is not None:
        check_file(arguments.out, _ELSEWHERE)
    capture = _capture(arguments)
    path = arguments.out or Path(f"{capture.name}.png")
    write_contact_sheet(capture, path)
    if arguments.json:
        tell({**_facts(capture), "sheet": str(path), "summary": summary(capture)})
        return 0
    say(summary(capture))
    say(f"contact sheet: {path}")
    return 0


def _data_check(arguments: argparse.Namespace) -> int:
    from ..bench.progress import steps
    from ..data.conventions import checked
    from ..data.inspection import troubles
    from ..data.overlay import write_sheet
    from ..files import check_file

    own = _own(arguments)
    sheet = arguments.out or (Path(f"{Path(arguments.capture).resolve().name}-check.png") if own else None)
    if sheet is not None:
        check_file(sheet, _ELSEWHERE)
    capture = _capture(arguments)
    if capture.layout and not arguments.json:
        say(f"{capture.name}: {capture.layout}, offers {', '.join(sorted(capture.offers))}")
    most = arguments.frames or (_READ if capture.layout else None)
    with steps() as told:
        found = list(troubles(capture, told("frames"), most))
    looked = checked(capture)
    if sheet is not None:
        write_sheet(capture, sheet)
    if arguments.json:
        about = {"overlap": looked.overlap, "doubts": list(map(str, looked.doubts)), "sheet": sheet and str(sheet)}
        tell({**_facts(capture), "troubles": list(map(str, found)), "remarks": list(capture.remarks), **about})
        return 2 if found or looked.doubts else 0
    for trouble in found:
        say(trouble)
    for remark in capture.remarks:
        say(f"{capture.name}: {remark}")
    if looked.overlap is not None:
        say(f"{capture.name}: hand and masks share {looked.overlap:.0%} of what they cover")
    for doubt in looked.doubts:
        say(f"{capture.name}: {doubt}")
    found += looked.doubts
    if sheet is not None:
        say(f"sheet: {sheet}")
    count, some = len(capture.frames()), ""
    if most is not None and count > most:
        some = f", of which {most} were read"
    say(f"{capture.name}: {count} frames{some}, " + (f"{len(found)} troubles" if found else "all sound"))
    return 2 if found else 0


def _data_template(arguments: argparse.Namespace) -> int:
    from ..data.folder.template import write_template

    path = write_template(arguments.place)
    if arguments.json:
        tell({"file": str(path)})
        return 0
    say(f"{path} is written: look through it, then run 'handbench data check {arguments.place}'")
    return 0


def _own(arguments: argparse.Namespace) -> bool:
    """Whether a folder is named, not a capture. One that is called like a capture which is made here is told by a
    slash; those that are brought lie in folders, and one of that name here is meant."""
    from ..data.openstage import PRESETS

    named = arguments.capture
    return "/" in named or (named not in PRESETS and Path(named).is_dir())


def _facts(capture: Any) -> dict[str, Any]:
    return {"capture": capture.name, "frames": len(capture.frames()), "digest": capture.digest}


def _capture(arguments: argparse.Namespace) -> Any:
    """The capture that is named; `data make` generates what is missing of it, with progress.

    Raises `InputError`, for the verbs that only look, if it is not there yet.
    """
    from ..bench.progress import steps
    from ..data import openstage
    from ..data.capture import open_capture

    if arguments.verb is not _data_make:
        if _own(arguments):
            from ..data.readers import open_at

            return open_at(Path(arguments.capture))
        if (name := arguments.capture) in openstage.PRESETS:
            openstage.check_made(_size(arguments), arguments.folder, openstage.generated(name))
    with steps() as told:
        return open_capture(arguments.capture, _size(arguments), arguments.folder, told)


def _size(arguments: argparse.Namespace) -> str:
    from ..data.capture import usual_size

    return usual_size(arguments.capture) if arguments.size is None else str(arguments.size)
