"""Weights on disk: the same weights are the same bytes, whatever process writes them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def test_equal_weights_are_equal_bytes_in_every_process(tmp_path: Path) -> None:
    code = (
        "import sys, torch\nfrom pathlib import Path\n"
        "from handbench.methods.kit.weights import load_state, save_state\n"
        "state = {'b': torch.arange(3.0), 'a': torch.ones(2, 2)}\nfolder = Path(sys.argv[1])\nfolder.mkdir()\n"
        "save_state(folder, 'm', {'steps': 3, 'rate': [1e-3, 1e-4]}, state)\n"
        "found = load_state(folder, 'm', {'rate': [1e-3, 1e-4], 'steps': 3})\n"
        "assert all(torch.equal(found[name], value) for name, value in state.items())\n"
    )
    written = set()
    for name in ("one", "two", "three", "four"):
        subprocess.run([sys.executable, "-c", code, str(tmp_path / name)], check=True)
        written.add((tmp_path / name / "weights.safetensors").read_bytes())
    assert len(written) == 1
