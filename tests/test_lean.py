"""open3d is loaded without the web pages of its viewer, which come when they are asked for."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import sys
from handbench.lean import open3d

o3d = open3d()
assert o3d is open3d() and o3d.core.Tensor([1]).numpy()[0] == 1 and o3d.t.geometry.RaycastingScene
assert not {"dash", "plotly"} & sys.modules.keys(), "the pages are loaded"
try:
    o3d.visualization.draw_plotly("no geometry")
except ImportError as error:
    assert "plotly, as it was asked for" in str(error)
else:
    raise AssertionError("the pages are not loaded when they are asked for")
"""


def test_pages_are_loaded_when_they_are_called_and_not_before(tmp_path):
    (tmp_path / "plotly.py").write_text("raise ImportError('plotly, as it was asked for')\n")
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
