"""How far the true surface without scattering is from the truth: `python -m benchmarks.surface_oracle`.

Some scored frames of each column of a protocol are traced once more from the surface, the skin, the light and the
samples that they were made with, but no light wanders under the skin: it leaves where it arrives. What is missing then
is what a perfect surface model would still lack, and where: the share of the squared error in display values that is in
the darker half of a hand's pixels. `--scattering` traces them as they were made, which must give them back.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from handbench.bench.resolving import resolve
from handbench.bench.run import find_protocol
from handbench.data.openstage import open_capture, preset
from handbench.data.openstage.performance import Maker, traced
from handbench.data.openstage.plans import production
from handbench.data.openstage.production import Production
from handbench.data.openstage.trace.pathtrace import PathTracer
from handbench.evenly import evenly
from handbench.metrics import Pair, metric, scores
from handbench.scene import Array, Frame, Prediction, needed
from handbench.scene.colour import srgb


def pictures(plan: Production, frames: list[Frame], scattering: bool) -> Iterator[tuple[Frame, Array]]:
    """Each frame and its picture (H, W, 3), traced with or without scattering; those of a pose follow one another."""
    performances = {one.key: one for one in plan.performances}
    tracer = PathTracer()
    maker = Maker(plan, Path(), tracer)  # for its skins: nothing is written
    views: dict[tuple[str, str], list[Frame]] = {}
    for frame in sorted(frames, key=lambda frame: (frame.subject, frame.pose_name, frame.camera.name)):
        views.setdefault((f"{frame.subject}/{frame.pose_name}", frame.camera.name), []).append(frame)
    for (key, _), seen in views.items():
        performance = performances[key]
        surface = traced(plan.surface(performance), maker.skin(performance.subject))
        if not scattering:
            surface = replace(surface, mean_free_path=None)
        lights = [frame.light for frame in seen]
        yield from zip(seen, tracer.render(surface, seen[0].camera, lights, plan.preset.spp, seed=0), strict=True)


def in_the_dark(pair: Pair) -> float:
    """The share of the squared error that lies in the darker half of the hand's pixels."""
    on = np.asarray(pair.mask) > 0.5
    truth, drawn = (srgb(np.asarray(image)[on].astype(np.float64)) for image in (pair.truth, pair.prediction))
    error, light = ((drawn - truth) ** 2).sum(axis=1), truth.sum(axis=1)
    return float(error[light <= np.median(light)].sum() / max(error.sum(), 1e-300))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.surface_oracle", description=__doc__)
    parser.add_argument("protocol", nargs="?", default="quick", help="on openstage (default: quick)")
    parser.add_argument("--frames", type=int, default=6, help="of each column (default: 6)")
    parser.add_argument("--scattering", action="store_true", help="trace as the frames were made")
    arguments = parser.parse_args()
    protocol = find_protocol(arguments.protocol)
    capture, plan = open_capture(protocol.size), production(preset(protocol.size))
    metrics = {spec: metric(spec) for spec in protocol.metrics}
    for column, frames in resolve(protocol, capture.frames()).scored.items():
        pairs = []
        for frame, image in pictures(plan, evenly(frames, arguments.frames), arguments.scattering):
            truth = capture.observe(frame)
            pairs.append(Pair.of(Prediction(image.astype(np.float32), needed(truth.alpha, "alpha")), truth))
        found = np.array([[score.value for score in row] for row in scores(list(metrics.values()), pairs)])
        told = ", ".join(f"{spec} {value:.4g}" for spec, value in zip(metrics, found.mean(axis=0), strict=True))
        span = f"psnr of a frame {found[:, 0].min():.4g} to {found[:, 0].max():.4g}"
        dark = np.median([in_the_dark(pair) for pair in pairs])
        print(f"{column}: {told}; {span}; {dark:.0%} in the dark; {len(pairs)} frames", flush=True)


if __name__ == "__main__":
    main()
