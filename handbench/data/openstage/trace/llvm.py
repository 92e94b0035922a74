"""Which Mitsuba variant this machine can run: the vectorised one needs an LLVM library that works.

A wrong LLVM does not raise: version 15 aborts the whole process when the principled BSDF is compiled. Each
candidate is therefore tried in a process of its own. That one works is kept on disk; that one failed is not, since
a busy machine may have been the reason.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from functools import cache
from importlib.metadata import version
from pathlib import Path

from ....cache import cache_folder
from ....files import whole
from ....terminal import complain

VECTORISED = "llvm_ad_rgb"
SCALAR = "scalar_rgb"

_PATTERNS = (  # under /
    "usr/lib/*/libLLVM*.so*",
    "usr/lib/llvm*/lib/libLLVM*.so*",
    "usr/lib64/libLLVM*.so*",
    "usr/local/lib/libLLVM*.so*",
    "opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "usr/local/opt/llvm*/lib/libLLVM*.dylib",
)

_PROBE = """
import mitsuba as mi
mi.set_variant("llvm_ad_rgb")
scene = mi.load_dict({
    "type": "scene", "integrator": {"type": "path"}, "light": {"type": "constant"},
    "sensor": {"type": "perspective", "film": {"type": "hdrfilm", "width": 4, "height": 4}},
    "shape": {"type": "sphere", "center": [0, 0, 4], "bsdf": {"type": "principled", "roughness": 0.4}},
})
assert mi.TensorXf(mi.render(scene, spp=1)).numpy().mean() > 0.1
print("works")
"""


def choose_variant() -> str:
    """The fastest Mitsuba variant that works here: "llvm_ad_rgb", or "scalar_rgb" with a message on stderr.

    Sets `DRJIT_LIBLLVM_PATH` for this process. The path a user has set is tried first. Must be called before
    Mitsuba's vectorised variant is used for the first time.
    """
    proven = _read_proven()
    for library in _candidates():
        key = f"{library}|{Path(library).stat().st_mtime_ns}|mitsuba {version('mitsuba')}"
        if key in proven or _works(library):
            if key not in proven:
                _write_proven([*proven, key])
            os.environ["DRJIT_LIBLLVM_PATH"] = library
            return VECTORISED
    complain(
        "Mitsuba runs as scalar_rgb, several times slower: no working LLVM library was found; "
        "install libllvm19 (apt install libllvm19) or set DRJIT_LIBLLVM_PATH"
    )
    return SCALAR


def _candidates() -> list[str]:
    """Real paths of LLVM libraries: the user's choice first, then newest version first."""
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH", "")
    found = {str(path.resolve()) for pattern in _PATTERNS for path in Path("/").glob(pattern)}
    ordered = sorted(found, key=_library_version, reverse=True)
    if chosen and Path(chosen).is_file():
        ordered = [chosen, *(path for path in ordered if path != str(Path(chosen).resolve()))]
    return ordered


def _library_version(path: str) -> tuple[int, ...]:
    """(19, 1) of "…/libLLVM.so.19.1", from the file's name or else its folder's."""
    numbers = re.findall(r"\d+", Path(path).name) or re.findall(r"llvm\D*(\d+)", path)
    return tuple(int(n) for n in numbers)


@cache
def _works(library: str) -> bool:
    environment = {**os.environ, "DRJIT_LIBLLVM_PATH": library}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _PROBE], env=environment, capture_output=True, text=True, timeout=120, check=False
        )
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0 and "works" in done.stdout


def _proven_file() -> Path:
    return cache_folder() / "llvm-works.json"


def _read_proven() -> list[str]:
    try:
        proven = json.loads(_proven_file().read_text())
    except (OSError, ValueError):
        return []
    return proven if isinstance(proven, list) else []


def _write_proven(proven: list[str]) -> None:
    """Keep what works; a folder that cannot be written only means probing again next time."""
    try:
        _proven_file().parent.mkdir(parents=True, exist_ok=True)
        with whole(_proven_file()) as part:
            part.write_text(json.dumps(proven, indent=1))
    except OSError:
        pass
