"""Weights on disk: the same weights are the same bytes, whatever process writes them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def test_equal_weights_are_equal_bytes_in_every_process(tmp_path: Path) -> None:
    """The library orders what it writes by chance, which it draws anew for every thread; Python for every process."""
    code = (
        "import sys, torch\nfrom pathlib import Path\nfrom threading import Thread\n"
        "from handbench.methods.kit.weights import load_state, save_state\n"
        "state = {'b': torch.arange(3.0), 'a': torch.ones(2, 2)}\n"
        "for folder in map(Path, sys.argv[1:]):\n    folder.mkdir()\n"
        "    arguments = (folder, 'm', {'steps': 3, 'rate': [1e-3, 1e-4]}, state)\n"
        "    thread = Thread(target=save_state, args=arguments)\n    thread.start()\n    thread.join()\n"
        "    found = load_state(folder, 'm', {'rate': [1e-3, 1e-4], 'steps': 3})\n"
        "    assert all(torch.equal(found[name], value) for name, value in state.items())\n"
    )
    folders = [tmp_path / name for name in ("one", "two", "three", "four", "five", "six")]
    for seed, mine in (("0", folders[:3]), ("1", folders[3:])):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        subprocess.run([sys.executable, "-c", code, *map(str, mine)], check=True, env=environment)
    assert len({(folder / "weights.safetensors").read_bytes() for folder in folders}) == 1
