"""handbench run and handbench check: protocols and the laws of methods."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ..terminal import complain, say
from .shared import cores, names, numbers, preset, report


def add(verbs: Any) -> None:
    run = verbs.add_parser("run", help="run a protocol and write its report; finished cells are reused")
    run.add_argument("protocol", help="a name that 'handbench list protocols' shows, or a TOML file")
    run.add_argument("--methods", type=names, metavar="A,B", help="instead of the protocol's methods")
    run.add_argument("--seeds", type=numbers, metavar="0,1", help="instead of the protocol's seeds")
    run.add_argument("--preset", type=preset, metavar="NAME", help="one preset for all methods")
    run.add_argument("--out", type=Path, metavar="DIR", help="run folder (default: runs/PROTOCOL)")
    run.add_argument("--data", type=Path, metavar="DIR", help="where captures are kept")
    run.add_argument("--device", default="cpu", help="where networks run: cpu (default), cuda, cuda:1, …")
    run.add_argument("--shard", metavar="I/N", help="only this part of the cells, for arrays of jobs on one run folder")
    run.add_argument(
        "--executor", default="local", metavar="NAME", help="local (default), or ray: the nodes of a cluster"
    )
    run.add_argument(
        "--cpus", type=cores, metavar="N", help="with ray, cores for each cell (default: the smallest node's)"
    )
    run.set_defaults(verb=_run, resumes=True)

    check = verbs.add_parser("check", help="try the laws of the method interface on a method")
    check.add_argument("method", help="a name that 'handbench list methods' shows")
    check.add_argument("--protocol", default="smoke", help="whose frames to try it on (default: smoke)")
    check.add_argument("--preset", type=preset, metavar="NAME")
    check.add_argument("--data", type=Path, metavar="DIR", help="where captures are kept")
    check.set_defaults(verb=_check)


def _run(arguments: argparse.Namespace) -> int:
    from ..bench.run import find_protocol, run
    from ..device import on_device
    from ..shards import Shard

    protocol = find_protocol(arguments.protocol)
    shard = None if arguments.shard is None else Shard.parse(arguments.shard)
    command = ["handbench", *sys.argv[1:]]
    chosen = (arguments.methods, arguments.seeds, arguments.preset, arguments.out, arguments.data)
    with on_device(arguments.device):
        outcome = run(protocol, *chosen, command, shard=shard, executor=arguments.executor, cpus=arguments.cpus)
    if not outcome.missing:
        page = report(outcome.folder)
    part = "" if shard is None else f"shard {shard}: "
    say(f"{part}{outcome.computed} cells computed, {outcome.reused} reused; run folder: {outcome.folder}")
    if outcome.missing:
        say(f"not there yet, of other shards: {len(outcome.missing)} cells, {_some(outcome.missing)}")
        say("the report is written by the shard that finishes last, or by the same command without --shard")
    else:
        say(f"report: {page}")
    for refused in outcome.refused:
        say(f"not tried: {refused}")
    for crash in outcome.crashed:
        complain(f"handbench: {crash}")
    return 1 if outcome.crashed else 0


def _some(labels: tuple[str, ...]) -> str:
    return ", ".join(labels[:3]) + (", …" if len(labels) > 3 else "")


def _check(arguments: argparse.Namespace) -> int:
    from ..bench.run import find_protocol
    from ..registry import METHODS

    METHODS.entry(arguments.method)
    protocol = find_protocol(arguments.protocol)
    from ..bench.check import check  # loads torch, which a mistyped name does without

    verdicts = check(arguments.method, protocol, arguments.preset, arguments.data)
    words = {True: "holds", False: "BROKEN", None: "n/a"}
    for verdict in verdicts:
        say(f"{verdict.law:<12} {words[verdict.holds]:<7} {verdict.detail}")
    return 1 if any(verdict.holds is False for verdict in verdicts) else 0
