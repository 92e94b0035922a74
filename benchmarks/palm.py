"""What PALM-Net's root search and a trained prior's rays cost: `python -m benchmarks.palm`.

Seconds are of one core's CPU. Roots: points a second, and how far the field of weights is from exact skinning. Rays,
with `--weights`: what skips save on a frame of that prior; `handbench speed` measures them on a hand that it teaches.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file

from handbench.hand import hand_model
from handbench.hand.canonical import AllBones, Deformation, NearestBones, Starts, WeightField, canonicalise
from handbench.methods.palm.config import PRESETS
from handbench.methods.palm.model import PalmModel
from handbench.studies.speed.volume import PersonView, skipped

POSES = ("rest", "random", "fist")


def roots() -> None:
    hand, rng = hand_model(), np.random.default_rng(1)
    field = WeightField.of(hand)
    print("pose    starts      points/s   without a root   field against exact skinning, mm: median, 95 %, most")
    for name in POSES:
        pose = hand.sample_pose(rng) if name == "random" else hand.named_pose(name)
        shape = torch.tensor(np.asarray(hand.sample_identity(rng))).float()
        joints = torch.tensor(pose.joints).float()
        deformation = Deformation(field, shape, joints)
        _ = deformation.nearest
        skin = hand.skin(shape, joints)
        off = 1e3 * (deformation.forward(field.coarse) - skin).norm(dim=1)
        error = ", ".join(f"{float(v):.2f}" for v in (off.median(), off.quantile(0.95), off.max()))
        chosen: list[tuple[str, Starts, int]] = [("all bones", AllBones(), 5_000)]
        chosen += [(f"nearest {k}", NearestBones(k), 50_000) for k in (1, 2, 4)]
        for label, starts, count in chosen:
            points = skin[torch.randint(len(skin), (count,))] + 3e-3 * torch.randn(count, 3)
            begin = time.process_time()
            found = canonicalise(deformation, points, starts)
            took = time.process_time() - begin
            none = float((~found.valid.any(dim=1)).float().mean())
            print(f"{name:7} {label:10} {count / took:9.0f} {none:16.4f}   {error}")


def rays(weights: Path) -> None:
    """A frame of the first person of a prior of `quick`, at rest."""
    state = load_file(weights)
    model = PalmModel(PRESETS["quick"], hand_model(), len(state["phi"]))
    model.load_state_dict(state)
    found = skipped(PersonView.of(model.requires_grad_(False), 256))
    for one in found:
        times = one.seconds / found[0].seconds
        print(f"{one.label:60} {one.seconds:8.2f} s {times:6.1f} times all skips   relative RMSE {one.error:.5f}")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.palm", description="Measure parts of PALM-Net.")
    parser.add_argument("--weights", type=Path, help="weights.safetensors of a trained prior of quick, for its rays")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    roots()
    if arguments.weights is not None:
        rays(arguments.weights)


main()
