"""handbench run and handbench check: protocols and the laws of methods."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ..terminal import complain, say
from .shared import (
    chosen_methods,
    chosen_protocol,
    cores,
    data_option,
    examples,
    json_option,
    methods_option,
    numbers,
    outcome_json,
    preset,
    protocol_options,
    report,
    setting_options,
    tell,
)


def add(verbs: Any) -> None:
    run = verbs.add_parser("run", help="run a protocol and write its report; finished cells are reused")
    protocol_options(run)
    methods_option(run, "the protocol's")
    run.add_argument("--seeds", type=numbers, metavar="0,1", help="instead of the protocol's seeds")
    setting_options(run)
    run.add_argument(
        "--out", type=Path, metavar="DIR", help="run folder (default: runs/PROTOCOL, and what was changed)"
    )
    run.add_argument(
        "--reuse",
        type=Path,
        metavar="DIR",
        help="also take what is finished from the run folders in DIR (default: those beside the run folder)",
    )
    run.add_argument("--fresh", action="store_true", help="take nothing from other run folders")
    run.add_argument("--device", default="cpu", help="where networks run: cpu (default), cuda, cuda:1, …")
    run.add_argument("--shard", metavar="I/N", help="only this part of the cells, for arrays of jobs on one run folder")
    run.add_argument(
        "--executor", default="local", metavar="NAME", help="local (default), or ray: the nodes of a cluster"
    )
    run.add_argument(
        "--cpus", type=cores, metavar="N", help="with ray, cores for each cell (default: the smallest node's)"
    )
    json_option(run)
    examples(
        run,
        "run quick  # the protocol's six methods",
        "run quick --methods 'oracle,mean,urhand*' --seeds 0,1,2  # the ablations of URHand, three seeds",
        "run quick --methods oracle,mean,./mine.py  # a method of yours, from a file",
        "run quick --methods urhand --set steps=500  # shorter training, in runs/quick-steps-500",
        "run quick --subjects s05 --limit 4  # one subject, four frames of each column",
    )
    run.set_defaults(verb=_run, resumes=True)

    check = verbs.add_parser("check", help="try the laws of the method interface on a method")
    check.add_argument("method", help="a name that 'handbench list methods' shows, or a file (./mine.py)")
    check.add_argument("--protocol", default="smoke", help="whose frames to try it on (default: smoke)")
    check.add_argument("--preset", type=preset, metavar="NAME", help="the method's preset (default: the protocol's)")
    data_option(check)
    json_option(check)
    examples(check, "check phong", "check ./mine.py --json")
    check.set_defaults(verb=_check)


def _run(arguments: argparse.Namespace) -> int:
    from ..bench.naming import run_folder
    from ..bench.run import run
    from ..device import on_device
    from ..errors import InputError
    from ..shards import Shard

    protocol = chosen_protocol(arguments)
    methods, extra = chosen_methods(arguments.methods)
    if extra and arguments.executor != "local":
        named = ", ".join(entry.name for entry in extra)
        raise InputError(f"the file of {named} is not on the nodes of a cluster; install the method there as a package")
    shard = None if arguments.shard is None else Shard.parse(arguments.shard)
    command = ["handbench", *sys.argv[1:]]
    out = arguments.out or run_folder(protocol, arguments.settings)
    chosen = (methods, arguments.seeds, arguments.preset, out, arguments.data)
    spread = {"shard": shard, "executor": arguments.executor, "cpus": arguments.cpus}
    with on_device(arguments.device):
        outcome = run(
            protocol,
            *chosen,
            command,
            extra=extra,
            settings=arguments.settings,
            reuse=_others(arguments, out),
            **spread,
        )
    page = None if outcome.missing else report(outcome.folder, quiet=arguments.json)
    if arguments.json:
        tell(outcome_json(outcome, page))
    else:
        _say(outcome, page, shard)
    for crash in outcome.crashed:
        complain(f"handbench: {crash}")
    return 1 if outcome.crashed else 0


def _others(arguments: argparse.Namespace, out: Path) -> tuple[Path, ...]:
    """The run folders whose finished cells are taken."""
    from ..bench.reuse import run_folders
    from ..errors import InputError

    if arguments.reuse is not None and not arguments.reuse.is_dir():
        raise InputError(f"--reuse {arguments.reuse} is no folder; give one that holds run folders")
    return () if arguments.fresh else tuple(run_folders(arguments.reuse or out.resolve().parent))


def _say(outcome: Any, page: Path | None, shard: Any) -> None:
    part = "" if shard is None else f"shard {shard}: "
    taken = f" ({outcome.taken} of other run folders)" if outcome.taken else ""
    say(f"{part}{outcome.computed} cells computed, {outcome.reused} reused{taken}; run folder: {outcome.folder}")
    if page is None:
        say(f"not there yet, of other shards: {len(outcome.missing)} cells, {_some(outcome.missing)}")
        say("the report is written by the shard that finishes last, or by the same command without --shard")
    else:
        say(f"report: {page}")
    if outcome.kept:
        say(f"also in the table, from earlier commands in this folder: {', '.join(outcome.kept)}")
    for gone in outcome.gone:
        say(f"no longer in the table: {gone}; its cells stay in {outcome.folder / 'cells'}")
    for refused in outcome.refused:
        say(f"not tried: {refused}")


def _some(labels: tuple[str, ...]) -> str:
    return ", ".join(labels[:3]) + (", …" if len(labels) > 3 else "")


def _check(arguments: argparse.Namespace) -> int:
    from ..bench.naming import named_methods
    from ..bench.plan import method_entries
    from ..bench.run import find_protocol

    (name, *_), extra = named_methods((arguments.method,))
    entry = method_entries((name,), extra)[name]
    protocol = find_protocol(arguments.protocol)
    from ..bench.check import check  # loads torch, which a mistyped name does without

    verdicts = check(entry, protocol, arguments.preset, arguments.data)
    words = {True: "holds", False: "BROKEN", None: "n/a"}
    if arguments.json:
        tell([{"law": v.law, "verdict": words[v.holds], "detail": v.detail} for v in verdicts])
    else:
        for verdict in verdicts:
            say(f"{verdict.law:<12} {words[verdict.holds]:<7} {verdict.detail}")
    return 1 if any(verdict.holds is False for verdict in verdicts) else 0
