"""The command line: argument parsing over one public function per verb. Nothing heavy is imported before it is used."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from . import __version__
from .errors import HandbenchError

_KINDS = ("protocols", "methods", "metrics", "captures")
_FORMATS = ("terminal", "latex", "csv", "markdown", "html")


def main(argv: list[str] | None = None) -> int:
    """Run a command and return its exit code: 0 done, 1 a method crashed or broke a law, 2 bad input, 130 stopped."""
    arguments = _parser().parse_args(argv)
    verb: Callable[[argparse.Namespace], int] = arguments.verb
    try:
        return verb(arguments)
    except HandbenchError as error:
        if os.environ.get("HANDBENCH_DEBUG"):
            raise
        print(f"handbench: {' '.join(str(error).split())}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("handbench: stopped; what was finished is kept, the same command goes on from there", file=sys.stderr)
        return 130
    except BrokenPipeError:  # the reader of a pipe has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _run(arguments: argparse.Namespace) -> int:
    from .bench.run import find_protocol, run
    from .device import on_device

    protocol = find_protocol(arguments.protocol)
    command = ["handbench", *sys.argv[1:]]
    chosen = (arguments.methods, arguments.seeds, arguments.preset, arguments.out, arguments.data)
    with on_device(arguments.device):
        outcome = run(protocol, *chosen, command)
    reports = importlib.import_module("handbench.reports")
    files = reports.write_reports(outcome.folder)
    _show(reports.render_terminal(reports.table(outcome.folder)))
    print(f"{outcome.computed} cells computed, {outcome.reused} reused; run folder: {outcome.folder}")
    print(f"report: {files['index.html']}")
    for crash in outcome.crashed:
        print(f"handbench: {crash}", file=sys.stderr)
    return 1 if outcome.crashed else 0


def _list(arguments: argparse.Namespace) -> int:
    from . import registry

    tables = {
        "protocols": registry.PROTOCOLS,
        "methods": registry.METHODS,
        "metrics": registry.METRICS,
        "captures": registry.CAPTURES,
    }
    for kind in [arguments.kind] if arguments.kind else _KINDS:
        entries = tables[kind].entries().values()
        width = max((len(entry.name) for entry in entries), default=0)
        print(kind)
        for entry in entries:
            print(f"  {entry.name:<{width}}  {entry.summary}")
    return 0


def _report(arguments: argparse.Namespace) -> int:
    reports = importlib.import_module("handbench.reports")
    if arguments.format == "html":
        print(reports.write_reports(arguments.run)["index.html"])
    elif arguments.format == "terminal":
        _show(reports.render_terminal(reports.table(arguments.run)))
    else:
        render = getattr(reports, f"render_{arguments.format}")
        print(render(reports.table(arguments.run)), end="")
    return 0


def _show(renderable: Any) -> None:
    from rich.console import Console

    Console().print(renderable)


def _capture(arguments: argparse.Namespace) -> Any:
    """The capture that is named; what is missing of it is generated, with progress."""
    from .bench.progress import steps
    from .registry import CAPTURES

    with steps() as told:
        label = f"capture {arguments.capture} {arguments.size}"
        return CAPTURES.load(arguments.capture)(arguments.size, arguments.folder, told(label))


def _data_make(arguments: argparse.Namespace) -> int:
    capture = _capture(arguments)
    print(f"{capture.name}: {len(capture.frames())} frames, digest {capture.digest[:16]}")
    return 0


def _data_show(arguments: argparse.Namespace) -> int:
    from .data.contactsheet import summary, write_contact_sheet

    capture = _capture(arguments)
    print(summary(capture))
    path = arguments.out or Path(f"{capture.name}.png")
    write_contact_sheet(capture, path)
    print(f"contact sheet: {path}")
    return 0


def _check(arguments: argparse.Namespace) -> int:
    from .bench.check import check
    from .bench.run import find_protocol
    from .registry import METHODS

    METHODS.entry(arguments.method)
    verdicts = check(arguments.method, find_protocol(arguments.protocol), arguments.preset, arguments.data)
    words = {True: "holds", False: "BROKEN", None: "n/a"}
    for verdict in verdicts:
        print(f"{verdict.law:<12} {words[verdict.holds]:<7} {verdict.detail}")
    return 1 if any(verdict.holds is False for verdict in verdicts) else 0


def _geometry(arguments: argparse.Namespace) -> int:
    study = importlib.import_module("handbench.methods.geometry.study")
    command = ["handbench", *sys.argv[1:]]
    out = arguments.out or Path("runs") / "geometry"
    found = study.run(arguments.protocol, out, arguments.data, arguments.preset, arguments.seed, command)
    _show(study.render(found["table"]))
    print(f"every frame: {out / study.RESULT}")
    return 0


def _stress(arguments: argparse.Namespace) -> int:
    from .bench.stress.record import render
    from .bench.stress.run import chosen_cases, stress

    if arguments.list:
        for case in chosen_cases(arguments.methods, arguments.only):
            print(f"{case.id}  {case.expected.text}")
        return 0
    done = stress(arguments.out, arguments.methods, arguments.only, ["handbench", *sys.argv[1:]])
    _show(render(done.results, done.seconds))
    print(f"all cases: {done.path}")
    if (arguments.out / "run.json").is_file():  # the folder of a run, whose page shows them
        print(f"report: {importlib.import_module('handbench.reports').write_reports(arguments.out)['index.html']}")
    return 0 if done.passed else 1


def _speed(arguments: argparse.Namespace) -> int:
    from .bench.progress import steps
    from .bench.speed.study import study, write

    with steps() as told:
        found = study(arguments.methods, arguments.quick, ["handbench", *sys.argv[1:]], told)
    path = write(arguments.out, found)
    speed = importlib.import_module("handbench.reports.speed")
    if (arguments.out / "run.json").is_file():  # the folder of a run, whose page shows the study
        page = importlib.import_module("handbench.reports").write_reports(arguments.out)["index.html"]
    else:
        page = speed.write_speed_report(arguments.out)
    _show(speed.render_speed(found))
    print(f"raw repeats: {path}")
    print(f"report: {page}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="handbench", description="Benchmark hand-relighting methods.")
    parser.add_argument("--version", action="version", version=f"handbench {__version__}")
    verbs = parser.add_subparsers(required=True, metavar="VERB")

    run = verbs.add_parser("run", help="run a protocol and write its report; finished cells are reused")
    run.add_argument("protocol", help="a name that 'handbench list protocols' shows, or a TOML file")
    run.add_argument("--methods", type=_names, metavar="A,B", help="instead of the protocol's methods")
    run.add_argument("--seeds", type=_numbers, metavar="0,1", help="instead of the protocol's seeds")
    run.add_argument("--preset", metavar="NAME", help="one preset for all methods")
    run.add_argument("--out", type=Path, metavar="DIR", help="run folder (default: runs/PROTOCOL)")
    run.add_argument("--data", type=Path, metavar="DIR", help="where captures are kept")
    run.add_argument("--device", default="cpu", help="where networks run: cpu (default), cuda, cuda:1, …")
    run.set_defaults(verb=_run)

    lists = verbs.add_parser("list", help="what can be named: protocols, methods, metrics, captures")
    lists.add_argument("kind", nargs="?", choices=_KINDS)
    lists.set_defaults(verb=_list)

    report = verbs.add_parser("report", help="print the table of a run, or write its page")
    report.add_argument("run", type=Path, help="the folder of a run")
    report.add_argument("--format", choices=_FORMATS, default="terminal")
    report.set_defaults(verb=_report)

    data = verbs.add_parser("data", help="make and show captures").add_subparsers(required=True, metavar="VERB")
    make = data.add_parser("make", help="generate what is missing of a capture")
    make.set_defaults(verb=_data_make)
    show = data.add_parser("show", help="summarise a capture and draw a contact sheet")
    show.add_argument("--out", type=Path, metavar="PNG", help="the picture (default: CAPTURE.png)")
    show.set_defaults(verb=_data_show)
    for verb in (make, show):
        verb.add_argument("capture", help="a name that 'handbench list captures' shows")
        verb.add_argument("--size", default="quick", metavar="SIZE")
        verb.add_argument("--folder", type=Path, metavar="DIR", help="where captures are kept")

    geometry = verbs.add_parser("geometry", help="train the hand geometry autoencoder and measure its errors")
    geometry.add_argument("protocol", help="whose subjects and frames; 'handbench list protocols' shows names")
    geometry.add_argument("--preset", metavar="NAME")
    geometry.add_argument("--seed", type=int, default=0)
    geometry.add_argument("--out", type=Path, metavar="DIR", help="where results go (default: runs/geometry)")
    geometry.add_argument("--data", type=Path, metavar="DIR", help="where captures are kept")
    geometry.set_defaults(verb=_geometry)

    check = verbs.add_parser("check", help="try the laws of the method interface on a method")
    check.add_argument("method", help="a name that 'handbench list methods' shows")
    check.add_argument("--protocol", default="smoke", help="whose frames to try it on (default: smoke)")
    check.add_argument("--preset", metavar="NAME")
    check.add_argument("--data", type=Path, metavar="DIR", help="where captures are kept")
    check.set_defaults(verb=_check)

    stress = verbs.add_parser("stress", help="try hard cases on the core and every method")
    stress.add_argument("--only", metavar="GLOB", help="the cases whose FAMILY/NAME fits, e.g. 'shading/*'")
    stress.add_argument("--methods", type=_names, metavar="A,B", help="instead of all registered methods")
    stress.add_argument("--out", type=Path, default=Path("runs/stress"), metavar="DIR", help="default: runs/stress")
    stress.add_argument("--list", action="store_true", help="list the cases and what is expected, try none")
    stress.set_defaults(verb=_stress)

    speed = verbs.add_parser("speed", help="error against time of the lighting core, its rivals and every method")
    speed.add_argument("--methods", type=_names, metavar="A,B", help="instead of all registered methods")
    speed.add_argument("--quick", action="store_true", help="one scene and fewer settings, about a minute")
    speed.add_argument("--out", type=Path, default=Path("runs/speed"), metavar="DIR", help="default: runs/speed")
    speed.set_defaults(verb=_speed)
    return parser


def _names(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise argparse.ArgumentTypeError("give at least one name")
    return names


def _numbers(text: str) -> tuple[int, ...]:
    try:
        numbers = tuple(int(number) for number in text.split(","))
    except ValueError:
        numbers = ()
    if not numbers or min(numbers) < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is no list of whole numbers such as 0,1,2")
    return numbers


if __name__ == "__main__":
    sys.exit(main())
