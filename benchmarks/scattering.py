"""Light under the skin, held to a random walk: `python -m benchmarks.scattering`; results in docs/scattering.md.

Mitsuba's `volpathmis` walks through a homogeneous medium behind a boundary that does not refract: skin 1 of Jensen et
al., "A practical model for subsurface light transport", 2001. The tracer gets the same diffuse mean free paths and,
as albedo, what a thick block of the medium reflects of even light; its lobes are off. The walk's medium has no boundary
that refracts, so it reflects more at grazing angles than skin and than the tracer.
"""

from __future__ import annotations

import argparse

import mitsuba as mi
import numpy as np

from handbench.data.openstage.trace.llvm import choose_variant
from handbench.data.openstage.trace.mitsuba_scene import emitter, sensor, shape
from handbench.data.openstage.trace.pathtrace import PathTracer, TracedSurface
from handbench.hand.openhand import OpenHand, named_pose
from handbench.scene import Array, Camera, Directional, Environment, Known, Mesh, Topology

SCATTERING = np.array([0.74, 0.88, 1.01]) * 1e3  # reduced, per metre
ABSORPTION = np.array([0.032, 0.17, 0.48]) * 1e3
MEAN_FREE_PATH = 1 / np.sqrt(3 * ABSORPTION * (ABSORPTION + SCATTERING))
SPACING = 0.6e-3
LIT, DARK = 0.35, 0.04
"""Lit parts are brighter than 0.35 of the brightest pixel, edges between 0.04 and that, in the walk's picture."""


def walked(mesh: Mesh, camera: Camera, light: Known, spp: int) -> Array:
    """The random walk's picture (H, W, 3)."""
    extinction = SCATTERING + ABSORPTION
    medium = {
        "type": "homogeneous",
        "albedo": {"type": "rgb", "value": (SCATTERING / extinction).tolist()},
        "sigma_t": {"type": "rgb", "value": (extinction / extinction.max()).tolist()},
        "scale": float(extinction.max()),
        "phase": {"type": "isotropic"},
    }
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "volpathmis", "max_depth": 256, "rr_depth": 64, "hide_emitters": True},
            "sensor": sensor(camera),
            "emitter": emitter(light),
            "shape": shape(mesh, bsdf={"type": "null"}, interior=medium),
        }
    )
    return np.array(mi.render(scene, spp=spp), dtype=np.float64)[..., :3]


def looking(width: int, height: int, metres: float, direction: tuple[float, float, float], target: Array) -> Camera:
    """A far camera that sees so many metres across its height."""
    backward = np.array(direction) / np.linalg.norm(direction)
    right = np.cross([0.0, -1.0, 0.0], -backward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(-backward, right), -backward])
    centre = target + backward
    K = np.array([[height / metres, 0, width / 2], [0, height / metres, height / 2], [0, 0, 1]])
    return Camera("study", width, height, K, np.concatenate([rotation, -(rotation @ centre)[:, None]], axis=1))


def ball(radius: float, spacing: float) -> Mesh:
    """A sphere about the origin, from a cube."""
    cube = _box(np.ones(3), spacing / radius)
    return Mesh(radius * cube.vertices / np.linalg.norm(cube.vertices, axis=1, keepdims=True), cube.topology)


def plate(width: float, thickness: float, spacing: float) -> Mesh:
    """A plate in the plane z = 0."""
    return _box(np.array([width, width, thickness]) / 2, spacing)


def _box(size: Array, spacing: float) -> Mesh:
    """A box about the origin, half as large as size, with square meshes."""
    vertices, faces, start = [], [], 0
    for axis in range(3):
        for side in (-1, 1):
            others = [(axis + 1) % 3, (axis + 2) % 3]
            steps = [max(2, round(2 * size[o] / spacing) + 1) for o in others]
            grid = np.stack(
                np.meshgrid(
                    *(np.linspace(-size[o], size[o], n) for o, n in zip(others, steps, strict=True)), indexing="ij"
                ),
                axis=-1,
            )
            points = np.zeros((grid.shape[0] * grid.shape[1], 3))
            points[:, others], points[:, axis] = grid.reshape(-1, 2), side * size[axis]
            i = start + np.arange(len(points)).reshape(steps)
            a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
            quads = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
            vertices.append(points)
            faces.append(quads if side > 0 else quads[:, ::-1])
            start += len(points)
    points, index = np.unique(np.round(np.concatenate(vertices), 9), axis=0, return_inverse=True)
    triangles = index.ravel()[np.concatenate(faces)]
    return Mesh(points, Topology(triangles, np.full((len(points), 2), 0.5), triangles))


def albedo(samples: int) -> Array:
    """What a thick block of the medium reflects of even light, (3,)."""
    sky = Environment("white", np.ones((8, 16, 3)))
    seen = walked(plate(0.06, 0.04, 0.02), looking(8, 8, 0.01, (0, 0, 1), np.zeros(3)), sky, samples)
    return seen.mean(axis=(0, 1))


def traced(mesh: Mesh, camera: Camera, light: Known, colour: Array, path: Array | None) -> Array:
    """The tracer's picture (H, W, 3) of the same thing."""
    surface = TracedSurface(
        mesh, np.broadcast_to(colour, (2, 2, 3)), np.full((2, 2), 0.5), specular=0.0, mean_free_path=path
    )
    return PathTracer().render(surface, camera, [light], 48, 0)[0].astype(np.float64)


def errors(walk: Array, found: Array) -> tuple[Array, Array, Array]:
    """Per channel: median relative error in lit parts, after one factor for each channel that makes their medians
    equal, that factor, and the mean difference at edges in units of the median of lit parts."""
    brightest = np.quantile(walk.mean(axis=2), 0.99)
    mean = walk.mean(axis=2) / brightest
    lit, edge = mean > LIT, (mean > DARK) & (mean <= LIT)
    factor = np.median(walk[lit], axis=0) / np.median(found[lit], axis=0)
    relative = np.median(np.abs(found * factor - walk)[lit] / walk[lit], axis=0)
    return relative, factor, (np.abs(found * factor - walk)[edge].mean(axis=0) / np.median(walk[lit], axis=0))


def sun(*direction: float) -> Directional:
    return Directional(np.array(direction) / np.linalg.norm(direction), np.full(3, 3.0))


def scenes(size: int) -> dict[str, tuple[Mesh, Camera, Known]]:
    """A ball lit from the side; a hand from two views, lit from the side and from behind."""
    hand = OpenHand.load()
    mesh = hand.mesh(hand.sample_identity(np.random.default_rng(1)), named_pose("rest"), 3)
    middle = np.array([0.0, 0.12, 0.0])
    return {
        "ball, 24 mm, from the side": (
            ball(0.012, SPACING), looking(size, size, 0.026, (0, 0, 1), np.zeros(3)), sun(1, 0, 0.2)
        ),
        "hand, back, from the side": (mesh, looking(size, size, 0.16, (0, 0, -1), middle), sun(1, 0.3, -0.3)),
        "hand, oblique, from behind": (mesh, looking(size, size, 0.16, (0.7, 0.3, -0.7), middle), sun(-0.4, 0.2, 1)),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.scattering", description="The tracer and a random walk."
    )
    parser.add_argument("--size", type=int, default=96, help="pixels on a side (default: 96)")
    parser.add_argument("--samples", type=int, default=1024, help="walks a pixel (default: 1024)")
    arguments = parser.parse_args()
    mi.set_variant(choose_variant())
    colour = albedo(4 * arguments.samples)
    print("albedo of the medium", *_three(colour))
    for thickness in (1.5e-3, 3e-3, 6e-3):
        mesh, camera = plate(0.04, thickness, SPACING), looking(8, 8, 0.008, (0, 0, 1), np.zeros(3))
        for side, light in (("front", sun(0, 0, 1)), ("behind", sun(0, 0, -1))):
            walk = walked(mesh, camera, light, 2 * arguments.samples).mean(axis=(0, 1))
            found = traced(mesh, camera, light, colour, MEAN_FREE_PATH).mean(axis=(0, 1))
            print(f"slab, {thickness * 1e3:g} mm, lit from {side}: walk", *_three(walk), "tracer", *_three(found))
    for name, (mesh, camera, light) in scenes(arguments.size).items():
        walk = walked(mesh, camera, light, arguments.samples)
        for model, path in (("scattering", MEAN_FREE_PATH), ("surface", None)):
            relative, factor, edge = errors(walk, traced(mesh, camera, light, colour, path))
            print(f"{name}, {model}: lit", *_three(relative), "factor", *_three(factor), "edges", *_three(edge))


def _three(values: Array) -> tuple[str, ...]:
    return tuple(f"{value:.3f}" for value in values)


if __name__ == "__main__":
    main()
