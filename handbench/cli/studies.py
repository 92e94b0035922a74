"""handbench speed, stress and geometry: studies beside the protocols."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ..studies import SUMMARIES
from ..terminal import say, show
from .shared import data_option, examples, json_option, names, preset, seed, tell


def add(verbs: Any) -> None:
    stress = verbs.add_parser("stress", help=SUMMARIES["stress"])
    stress.add_argument(
        "--cases", "--only", dest="only", metavar="GLOB", help="the cases whose FAMILY/NAME fits, e.g. 'shading/*'"
    )
    stress.add_argument("--methods", type=names, metavar="A,B", help="instead of all registered methods")
    stress.add_argument("--out", type=Path, default=Path("runs/stress"), metavar="DIR", help="default: runs/stress")
    stress.add_argument("--list", action="store_true", help="list the cases and what is expected, try none")
    json_option(stress)
    examples(stress, "stress", "stress --methods urhand --cases 'shading/*'", "stress --list")
    stress.set_defaults(verb=_stress)

    speed = verbs.add_parser("speed", help=SUMMARIES["speed"])
    speed.add_argument("--methods", type=names, metavar="A,B", help="instead of all registered methods")
    speed.add_argument(
        "--short", "--quick", dest="short", action="store_true", help="one scene and fewer settings, about a minute"
    )
    speed.add_argument("--out", type=Path, default=Path("runs/speed"), metavar="DIR", help="default: runs/speed")
    json_option(speed)
    examples(speed, "speed --short", "speed --methods phong,physical --out runs/quick  # into the page of a run")
    speed.set_defaults(verb=_speed)

    geometry = verbs.add_parser("geometry", help=SUMMARIES["geometry"])
    geometry.add_argument("protocol", help="whose subjects and frames; 'handbench list protocols' shows names")
    geometry.add_argument("--preset", type=preset, metavar="NAME", help="of the autoencoder (default: the protocol's)")
    geometry.add_argument("--seed", type=seed, default=0, metavar="N", help="of the training (default: 0)")
    geometry.add_argument("--out", type=Path, metavar="DIR", help="where results go (default: runs/geometry)")
    data_option(geometry)
    json_option(geometry)
    examples(geometry, "geometry smoke", "geometry quick --preset standard --seed 1")
    geometry.set_defaults(verb=_geometry)


def _stress(arguments: argparse.Namespace) -> int:
    from ..files import check_folder
    from ..registry import STUDIES
    from ..studies.stress.record import render
    from ..studies.stress.run import chosen_cases

    if arguments.list:
        cases = chosen_cases(arguments.methods, arguments.only)
        if arguments.json:
            tell({case.id: case.expected.text for case in cases})
            return 0
        for case in cases:
            say(f"{case.id}  {case.expected.text}")
        return 0
    check_folder(arguments.out)
    done = STUDIES.load("stress")(arguments.out, arguments.methods, arguments.only, ["handbench", *sys.argv[1:]])
    page = None
    if (arguments.out / "run.json").is_file():  # the folder of a run, whose page shows them
        from ..reports import write_reports

        page = write_reports(arguments.out)["index.html"]
    if arguments.json:
        tell({"passed": done.passed, "cases": str(done.path), "report": None if page is None else str(page)})
        return 0 if done.passed else 1
    show(render(done.results, done.seconds))
    say(f"all cases: {done.path}")
    if page is not None:
        say(f"report: {page}")
    return 0 if done.passed else 1


def _speed(arguments: argparse.Namespace) -> int:
    from ..bench.progress import steps
    from ..files import check_folder
    from ..registry import STUDIES
    from ..studies.speed.record import write

    check_folder(arguments.out)
    with steps() as told:
        found = STUDIES.load("speed")(arguments.methods, arguments.short, ["handbench", *sys.argv[1:]], told)
    path = write(arguments.out, found)
    from ..reports import write_reports
    from ..reports.speed import render_speed, write_speed_report

    if (arguments.out / "run.json").is_file():  # the folder of a run, whose page shows the study
        page = write_reports(arguments.out)["index.html"]
    else:
        page = write_speed_report(arguments.out)
    if arguments.json:
        tell({"repeats": str(path), "report": str(page)})
        return 0
    show(render_speed(found))
    say(f"raw repeats: {path}")
    say(f"report: {page}")
    return 0


def _geometry(arguments: argparse.Namespace) -> int:
    from ..files import check_folder
    from ..registry import STUDIES

    out = arguments.out or Path("runs") / "geometry"
    check_folder(out)
    run = STUDIES.load("geometry")
    command = ["handbench", *sys.argv[1:]]
    found = run(arguments.protocol, out, arguments.data, arguments.preset, arguments.seed, command)
    from ..studies.geometry.study import RESULT, render

    if arguments.json:
        tell({"frames": str(out / RESULT), "table": found["table"]})
        return 0
    show(render(found["table"]))
    say(f"every frame: {out / RESULT}")
    return 0
