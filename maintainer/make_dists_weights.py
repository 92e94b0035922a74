"""Write metrics/weights/dists.safetensors from the wheel of dists-pytorch 0.1.

    pip download --no-deps dists-pytorch==0.1
    python maintainer/make_dists_weights.py DISTS_pytorch-0.1-py3-none-any.whl

The wheel carries the two learned weights of each of the 1,475 channels that DISTS compares. It is never imported: its
hash is checked, and torch reads the file with `weights_only`. The result is the same byte for byte at every run.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import sys
import zipfile
from pathlib import Path

import numpy as np
import torch
from safetensors.numpy import save

SHA256 = "73e54ce13e7cf3ca962ee8e433d129884ec3dc75e00a27af90525e1da760ac61"
MEMBER = "DISTS_pytorch/weights.pt"
TARGET = Path(__file__).resolve().parent.parent / "metrics" / "weights" / "dists.safetensors"
CHANNELS = 3 + 64 + 128 + 256 + 512 + 512  # the picture and five layers of VGG-16
PROVENANCE = f"dists-pytorch 0.1 (sha256 {SHA256}), float32; MIT, copyright 2020 Keyan Ding; see NOTICE"


def tensors(file: bytes) -> dict[str, np.ndarray]:
    """alpha and beta (1475,) float32 of the authors' checkpoint."""
    stored = torch.load(io.BytesIO(file), weights_only=True)
    named = {name: stored[name].numpy().reshape(-1) for name in ("alpha", "beta")}
    for name, value in named.items():
        if value.dtype != np.float32 or value.shape != (CHANNELS,) or not np.isfinite(value).all():
            sys.exit(f"{name}: expected {CHANNELS} finite float32 values, found {value.dtype} {value.shape}")
    return named


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("wheel", type=Path, help="DISTS_pytorch-0.1-py3-none-any.whl")
    parser.add_argument("--out", type=Path, default=TARGET, help="file to write (default: in metrics/weights)")
    arguments = parser.parse_args()
    data = arguments.wheel.read_bytes()
    digest = hashlib.sha256(data).hexdigest()
    if digest != SHA256:
        sys.exit(f"{arguments.wheel}: sha256 is {digest}, expected {SHA256}; download dists-pytorch 0.1 again")
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        named = tensors(archive.read(MEMBER))
    arguments.out.write_bytes(save(named, metadata={"provenance": PROVENANCE}))
    print(f"{arguments.out}: {len(named)} tensors, {arguments.out.stat().st_size / 1e3:.1f} kB")


if __name__ == "__main__":
    main()
