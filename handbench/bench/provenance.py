"""Where a result comes from: commit, packages, machine, command. Captured when a run starts, never repaired."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

from .. import __version__
from ..device import device_name
from ..installed import owner_version, version
from ..memory import physical_memory
from ..results.origin import Git, Hardware, Plugin, Provenance


def provenance(command: list[str], targets: Iterable[str] = ()) -> Provenance:
    """Everything a reader needs to judge or repeat a run; `targets` are those of its plug-ins."""
    return Provenance(
        version=__version__,
        git=git_state(Path(__file__).parents[1] / "__init__.py"),
        command=shlex.join(command),
        python=platform.python_version(),
        packages=packages(),
        plugins=plugins(targets),
        os=platform.platform(),
        device=device(),
        started=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def git_state(file: Path) -> Git | None:
    """Commit and dirty flag of the checkout that tracks a file; None for an installed copy."""

    def git(*arguments: str) -> str | None:
        command = ["git", "-C", str(file.parent), *arguments]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
        except (OSError, subprocess.TimeoutExpired):
            return None
        return done.stdout.strip() if done.returncode == 0 else None

    # A wheel in an environment inside someone's repository is not part of it: the file must be tracked.
    if git("ls-files", "--error-unmatch", file.name) is None:
        return None
    return Git(git("rev-parse", "HEAD"), bool(git("status", "--porcelain")))


def plugins(targets: Iterable[str]) -> dict[str, Plugin]:
    """Version, commit and dirty flag of the packages other than handbench that plug-ins ("module:attribute") are of."""
    roots = sorted({target.partition(":")[0].partition(".")[0] for target in targets} - {"handbench"})
    found = {}
    for root in roots:
        spec = importlib.util.find_spec(root)
        git = git_state(Path(spec.origin)) if spec and spec.origin else None
        found[root] = Plugin(owner_version(root), git)
    return found


def packages() -> dict[str, str]:
    """Versions of handbench's installed requirements, those of optional extras included."""
    found = {}
    for requirement in importlib.metadata.requires("handbench") or []:
        name = re.split(r"[^A-Za-z0-9._-]", requirement, maxsplit=1)[0]
        if (known := version(name)) is not None:
            found[name] = known
    return dict(sorted(found.items()))


def device() -> Hardware:
    """The machine, for telling which times may be compared. GPUs are named only when torch is already in use."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    torch, memory = sys.modules.get("torch"), physical_memory()
    gpus = []
    if torch is not None and torch.cuda.is_available():
        gpus = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
    threads = torch.get_num_threads() if torch is not None else int(os.environ.get("OMP_NUM_THREADS") or cores or 1)
    memory_gb = None if memory is None else round(memory / 2**30, 1)
    return Hardware(_cpu_model(), cores, threads, memory_gb, tuple(gpus), device_name())


def _cpu_model() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        text = ""
    found = re.search(r"^model name\s*:\s*(.+)$", text, re.MULTILINE)
    return found[1].strip() if found else platform.processor() or platform.machine()
