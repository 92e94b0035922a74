"""Write methods/kit/weights/alexnet.safetensors: the first three layers of metrics/weights/lpips_alex.safetensors.

    python maintainer/make_alexnet_weights.py

A copy, so that the losses of methods do not change with a metric. The file is the same byte for byte at every run.
"""

from __future__ import annotations

from pathlib import Path

from safetensors import safe_open
from safetensors.numpy import load_file, save

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "metrics" / "weights" / "lpips_alex.safetensors"
TARGET = ROOT / "methods" / "nets" / "weights" / "alexnet.safetensors"
LAYERS = 3


def main() -> None:
    with safe_open(SOURCE, "numpy") as file:
        provenance = file.metadata()
    stored = load_file(SOURCE)
    kept = {f"conv{i}.{part}": stored[f"conv{i}.{part}"] for i in range(LAYERS) for part in ("weight", "bias")}
    TARGET.parent.mkdir(exist_ok=True)
    TARGET.write_bytes(save(kept, metadata=provenance))


if __name__ == "__main__":
    main()
