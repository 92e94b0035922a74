"""What PALM-Net's parts cost and how exact they are: `python -m benchmarks.palm`; results in docs/palm-net.md.

Seconds are of one core's CPU. Roots: points a second, and how far the field of weights is from exact skinning.
Encodings: error of a neutral hand's signed distance after as many steps of the same network. Rays: a frame of a prior
that has seen a few scans, with all skips, with each of them off, and by the same equations without any: all bones, no
shell, even marching through the whole box.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from safetensors.torch import load_file
from torch import Tensor

from handbench.data.openstage import open_capture
from handbench.hand import hand_model
from handbench.hand.canonical import AllBones, Deformation, NearestBones, Starts, WeightField, canonicalise
from handbench.method import silent
from handbench.methods.palm.config import PRESETS, Config
from handbench.methods.palm.model import PalmModel
from handbench.methods.palm.posed import PosedHand, render
from handbench.methods.palm.training import trained
from handbench.render.volume import Shell
from handbench.scene import Camera
from handbench.skips import NONE, Skips, skipping

POSES = ("rest", "random", "fist")


def cpu(work: Callable[[], object]) -> float:
    """Seconds of CPU of a call."""
    start = time.process_time()
    work()
    return time.process_time() - start


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


def encodings(steps: int) -> None:
    """Fit the neutral hand's signed distance within 8 mm of its skin."""
    hand = hand_model()
    mesh = hand.mesh(hand.neutral(), hand.named_pose("rest"), 2)
    shell = Shell.around(mesh.vertices, mesh.topology.faces, 8e-3, 1e-3)
    nodes, distance = shell.lattice.nodes(), shell.distance[:, 0]
    near = (distance.abs() < 6e-3).nonzero()[:, 0]
    shape, joints = torch.tensor(np.asarray(hand.neutral())).float(), torch.zeros(len(hand.parents), 3)
    variants = {
        "tri-plane": PRESETS["quick"],
        "hash 8 levels": replace(PRESETS["quick"], encoding="hash"),
        "hash 12 levels": replace(PRESETS["quick"], encoding="hash", levels=12, finest=1024.0, table=16),
    }
    print("encoding         error after steps, mm                         ms a step   100k points, with normals: ms")
    for name, config in variants.items():
        torch.manual_seed(0)
        model = PalmModel(config, hand, 1)
        adam = torch.optim.Adam(model.geometry_field.parameters(), lr=5e-3, betas=(0.9, 0.99))
        told, spent = [], 0.0
        rows = torch.Generator().manual_seed(1)
        test = near[torch.randint(len(near), (20_000,), generator=rows)]

        def error() -> float:
            with torch.no_grad():
                conditions = model.conditions(model.codes(0), shape, joints)  # noqa: B023
                found = model.geometry(nodes[test], conditions).sdf  # noqa: B023
                return float((found - distance[test]).abs().mean()) * 1e3  # noqa: B023

        for step in range(1, steps + 1):
            begin = time.process_time()
            some = near[torch.randint(len(near), (4096,), generator=rows)]
            conditions = model.conditions(model.codes(0), shape, joints)
            found = model.geometry(nodes[some], conditions, gradient=True)
            assert found.gradient is not None
            loss = ((found.sdf - distance[some]) / 5e-3).abs().mean()
            loss = loss + 0.1 * (found.gradient.norm(dim=1) - 1.0).square().mean()
            adam.zero_grad()
            loss.backward()
            for group in adam.param_groups:
                group["lr"] = 5e-3 * 0.1 ** (step / steps)
            adam.step()
            spent += time.process_time() - begin
            if step in (steps // 8, steps // 4, steps // 2, steps):
                told.append(f"{step}: {error():.3f}")
        many = nodes[near[torch.randint(len(near), (100_000,))]]

        def forward(gradient: bool) -> None:
            with torch.no_grad():
                model.geometry(many, model.conditions(model.codes(0), shape, joints), gradient)  # noqa: B023

        times = [1e3 * cpu(lambda: forward(gradient)) for gradient in (False, True)]  # noqa: B023
        print(f"{name:16} {', '.join(told):46} {1e3 * spent / steps:10.1f} {times[0]:16.0f} {times[1]:14.0f}")


def rays(width: int, height: int, weights: str | None) -> None:
    """A frame of a prior of `quick` whose weights are given, or of one that has seen a little."""
    capture = open_capture("mini", capture="openscans")
    some = [f for f in capture.frames() if f.subject == "s25"]
    config = replace(PRESETS["quick"], geometry_steps=100, steps=40, patch=16, light_from=2.0)
    hand = hand_model()
    if weights is None:
        model = trained(config, hand, capture.recording(some), 0, silent)
    else:
        state = load_file(weights)
        model = PalmModel(config, hand, len(state["phi"]))
        model.load_state_dict(state)
    frame = some[0]
    assert frame.pose is not None and frame.shape is not None
    told = (frame.pose.joints, frame.pose.rotation, frame.pose.translation)
    placed = [torch.from_numpy(values.copy()).float() for values in told]
    shape = torch.from_numpy(frame.shape.copy()).float()
    posed: list[PosedHand] = []
    with torch.no_grad():
        making = cpu(lambda: posed.append(PosedHand(model, model.codes(0), shape, *placed)))
        making += cpu(lambda: (posed[0].shell, posed[0].deformation.nearest))
    K = frame.camera.K.copy()
    K[0] *= width / frame.camera.width
    K[1] *= height / frame.camera.height
    camera = Camera("frame", width, height, K, frame.camera.world_to_camera)
    towards = torch.nn.functional.normalize(torch.from_numpy(camera.rays().reshape(-1, 3)).float(), dim=1)
    origins = torch.from_numpy(camera.centre.copy()).float().expand(len(towards), 3)
    print(f"a new pose: {making:.2f} s; a frame of {width} x {height}, {config.samples} samples a ray:")

    def seen(skips: Skips, every: int = 1, changed: Config | None = None) -> tuple[float, Tensor]:
        model.config = changed or config
        marching = replace(model.config.marching, step=1e-3) if skips == NONE else model.config.marching
        begin = time.process_time()
        with skipping(skips), torch.no_grad():
            pieces = [
                render(posed[0], origins[part], towards[part], marching).radiance(posed[0])
                for part in torch.arange(0, len(towards), every).split(4096)
            ]
        model.config = config
        return every * (time.process_time() - begin), torch.cat(pieces)

    least, every = 16, Skips()
    took, picture = seen(every)
    print(f"  all skips                     {took:7.2f} s")
    for switch in ("outside_box", "empty_space", "saturated", "weightless"):
        off, plain = seen(replace(every, **{switch: False}), 4)
        apart = float((plain - picture[::4]).abs().mean())
        print(f"  without {switch:21} {off:7.2f} s   mean difference {apart:.5f}")
    plain_time, plain = seen(NONE, least, replace(config, bones=0))
    apart = (plain - picture[::least]).abs()
    print(f"  none, all bones, 1 mm steps   {plain_time:7.2f} s ({plain_time / took:.0f} times)   ", end="")
    print(f"mean difference {float(apart.mean()):.5f}, 99 % below {float(apart.quantile(0.99)):.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.palm", description="Measure the parts of PALM-Net.")
    parser.add_argument("parts", nargs="*", default=["roots", "encodings", "rays"], help="roots, encodings, rays")
    parser.add_argument("--steps", type=int, default=400, help="of each encoding (default: 400)")
    parser.add_argument("--weights", help="weights.safetensors of a trained prior of quick, for rays")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    for part in arguments.parts:
        {
            "roots": roots,
            "encodings": lambda: encodings(arguments.steps),
            "rays": lambda: rays(192, 256, arguments.weights),
        }[part]()


main()
