"""More processes at work on one capture: the tracer leaves a core idle for much of the time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .presets import CaptureName, preset

_CODE = "import sys; from handbench.data.openstage.helpers import assist; assist(sys.argv[1])"


@contextmanager
def helped(capture: CaptureName, size: str, place: Path, count: int) -> Iterator[None]:
    """`count` more processes make a capture into its folder `place` inside the block; they end with it.

    They begin at its end, so that they seldom need the skin that this process is at. One that fails or dies leaves its
    work to this one.
    """
    settings = json.dumps([capture, size, str(place), os.getpid()])
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    helpers = [
        subprocess.Popen([sys.executable, "-c", _CODE, settings], env=environment, **quiet)  # type: ignore[call-overload]
        for _ in range(count)
    ]
    try:
        yield
    finally:
        for helper in helpers:
            helper.terminate()
        for helper in helpers:
            helper.wait()


def assist(settings: str) -> None:
    """Make poses from the last to the first, until all are made or the process that asked is gone."""
    from dataclasses import replace

    from .make import make
    from .plans import production

    capture, size, place, owner = json.loads(settings)

    def watched(step: int, total: int, **values: float) -> None:
        if os.getppid() != owner:
            sys.exit()

    plan = production(preset(size, capture))
    backwards = replace(plan, performances=plan.performances[::-1])
    make(backwards, Path(place), watched, finish=False)
