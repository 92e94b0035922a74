"""Try bad inputs and count what goes wrong: `python -m benchmarks.bad_inputs --count 1000 --seed 0`.

Exit code 1 if there was a traceback, a hang, a death of the process, a silent wrong value or a refusal without a word.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from .bases import make_bases
from .case import BAD, VERDICTS, BadInput, CommandResult, verdict
from .families import FAMILIES, generate
from .runner import LIMIT, answers


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bad_inputs", description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="how many inputs (default: 1000)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=FAMILIES, help="one family")
    parser.add_argument("--jobs", type=int, default=2, help="processes side by side (default: 2)")
    parser.add_argument("--limit", type=float, default=LIMIT, metavar="SECONDS", help="for one input (default: 60)")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin no further input then (default: no end)")
    parser.add_argument("--out", type=Path, metavar="JSON", help="write every fault there")
    arguments = parser.parse_args()
    start = time.monotonic()
    counts: dict[str, Counter[str]] = {name: Counter() for name in FAMILIES}
    faults = []
    with tempfile.TemporaryDirectory() as folder:
        cases = generate(arguments.count, arguments.seed, make_bases(Path(folder)), arguments.only)
        for case, answer in answers(cases, arguments.jobs, arguments.limit):
            found = verdict(case, answer)
            counts[case.family][found] += 1
            if found in BAD:
                faults.append(_fault(case, answer, found))
                print(json.dumps(faults[-1])[:600], file=sys.stderr, flush=True)
            done = sum(of.total() for of in counts.values())
            if done % 100 == 0:
                print(f"{done} of {arguments.count}, {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)
            if time.monotonic() - start > 60.0 * arguments.minutes:
                break
    print(_table(counts, time.monotonic() - start))
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(faults, indent=1) + "\n")
    return 1 if faults else 0


def _fault(case: BadInput, answer: CommandResult, found: str) -> dict[str, str]:
    words = " ".join(case.process or case.words)
    lines = (answer.err.strip() or answer.out.strip()).splitlines()
    about = {"verdict": found, "family": case.family, "name": case.name, "words": words, "code": str(answer.code)}
    return {**about, "environment": json.dumps(case.environment), "said": " … ".join(lines[-2:])[:500]}


def _table(counts: dict[str, Counter[str]], seconds: float) -> str:
    rows = [("family", *VERDICTS, "all")]
    rows += [(name, *(str(of[v]) for v in VERDICTS), str(of.total())) for name, of in counts.items() if of]
    totals = sum(counts.values(), Counter())
    rows.append(("all", *(str(totals[v]) for v in VERDICTS), str(totals.total())))
    lines = ["  ".join(f"{cell:>12}" if i else f"{cell:<12}" for i, cell in enumerate(row)) for row in rows]
    return "\n".join([*lines, f"{seconds:.0f} s"])


if __name__ == "__main__":
    sys.exit(main())
