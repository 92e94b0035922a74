"""How noisy pictures of the light stage are under each of its environments: one view drawn with two seeds.

    python -m benchmarks.noise --size quick --samples 96 128

tells for each map and number of samples a pixel the median over the hand's pixels and channels of |a - b| / (a + b),
times the square root of two: how far off a pixel of one picture is, of which two, a and b, tell. After it, in brackets,
the same of the pixels at the rims, which see the surface at a grazing angle and mirror much.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from handbench.data.openstage import preset
from handbench.data.openstage.performance import Maker, traced
from handbench.data.openstage.plans import production
from handbench.data.openstage.trace.pathtrace import PathTracer
from handbench.scene import Array

_DARK = 1e-3  # pixels below are black to the eye
_GRAZING = 0.3  # cosine between normal and line of sight at a rim


def noise(first: Array, second: Array, inside: Array) -> float:
    """The median relative noise of pictures (H, W, 3) where `inside` (H, W)."""
    a, b = first[inside].astype(np.float64), second[inside].astype(np.float64)
    seen = a + b > 2 * _DARK
    return float(np.median(np.abs(a - b)[seen] / (a + b)[seen]) * np.sqrt(2.0))


def main() -> None:
    parser = argparse.ArgumentParser(description="how noisy pictures under environments are")
    parser.add_argument("--size", default="quick")
    parser.add_argument("--samples", type=int, nargs="+", help="a pixel (default: those of the size)")
    parser.add_argument("--camera", default="oblique")
    arguments = parser.parse_args()
    size = preset(arguments.size)
    every = arguments.samples or [size.spp]
    plan = production(replace(size, **{"subjects": 1, "train_poses": 1, "held_out_poses": 0}))
    pose = plan.performances[0]
    camera = next(camera for camera in plan.cameras if camera.name == arguments.camera)
    maps = [lighting for lighting in plan.lightings if lighting.kind == "environment"]
    tracer = PathTracer()
    surface = traced(plan.surface(pose), Maker(plan, Path(), tracer).skin(pose.subject))
    drawn: dict[tuple[int, int], Array] = {}
    for seed in (0, 1):
        for samples in every:
            start = time.process_time()
            lights = [lighting.light for lighting in maps]
            drawn[seed, samples] = tracer.render(surface, camera, lights, samples, seed)
            print(f"seed {seed}, {samples} samples: {time.process_time() - start:.0f} s of the processor", flush=True)
    seen = tracer.gbuffer(surface, camera, 16)
    inside = seen.alpha > 0.99
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ camera.ray_matrix
    facing = -(seen.normal * rays).sum(axis=-1) / np.linalg.norm(rays, axis=-1)
    for samples in every:
        for lighting, a, b in zip(maps, drawn[0, samples], drawn[1, samples], strict=True):
            rim = noise(a, b, inside & (facing < _GRAZING))
            print(f"{samples} samples, {lighting.name}: {noise(a, b, inside):.2%} ({rim:.2%})")


if __name__ == "__main__":
    main()
