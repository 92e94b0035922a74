"""One performance made: its skin, its surface, its pictures and its geometry, view by view."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import scipy.sparse

from ...files import whole
from ...scene import Array, Mesh, Topology
from ..exr import rgb, write_exr
from .cast import Subject
from .production import Performance, Production, RenderTask
from .skin import Skin, make_skin
from .trace.pathtrace import GBuffer, PathTracer, TracedSurface, displace

TRACKING_NOISE = 3e-4  # metres, root mean square distance of a tracked vertex from the true coarse surface
_BRIGHTEST = 60000.0  # half floats end at 65504
_COVERAGE = 16  # samples of a pixel's coverage and geometry


class Maker:
    """Makes performances of a production into `folder`; keeps the skin of the last subject for the next."""

    def __init__(self, production: Production, folder: Path, tracer: PathTracer) -> None:
        self.folder = folder
        self._production, self._tracer = production, tracer
        self._skin: tuple[Subject, Skin] | None = None

    def make(self, performance: Performance) -> Iterator[RenderTask]:
        """Write what is missing of a performance; gives each view once it is whole."""
        production = self._production
        folder = self.folder / performance.key
        folder.mkdir(parents=True, exist_ok=True)
        self._save_mesh(performance, folder)
        surface: TracedSurface | None = None
        for view in performance.views:
            place = folder / view.camera.name
            if not is_whole(place, view):
                surface = surface or traced(production.surface(performance), self.skin(performance.subject))
                self._write(surface, view, place)
            yield view

    def skin(self, subject: Subject) -> Skin:
        """The textures of a subject."""
        if self._skin is None or self._skin[0] is not subject:
            production = self._production
            made = make_skin(production.hand, subject.identity, subject.look, production.preset.skin_size)
            self._skin = subject, made
        return self._skin[1]

    def _write(self, surface: TracedSurface, view: RenderTask, folder: Path) -> None:
        """Render a view and write a picture for each of its lightings, then the geometry."""
        production, camera = self._production, view.camera
        folder.mkdir(exist_ok=True)
        lights = [lighting.light for lighting in view.lightings]
        images = self._tracer.render(surface, camera, lights, spp=production.preset.spp, seed=0)
        seen = self._tracer.gbuffer(surface, camera, spp=_COVERAGE)
        channels = _channels(seen, with_uv=production.meshes == "tracked")
        for lighting, image in zip(view.lightings, images, strict=True):
            if view.device is not None:
                rng = np.random.default_rng(zlib.crc32(f"{folder.relative_to(self.folder)}/{lighting.name}".encode()))
                image, alpha, depth = view.device.take(image, seen.alpha, seen.depth, seen.normal, camera, rng)
                channels = {"A": alpha.astype(np.float16), "depth.Z": depth}
            write_exr(folder / f"{lighting.name}.exr", rgb(np.clip(image, 0.0, _BRIGHTEST)))
        write_exr(folder / "geometry.exr", channels)

    def _save_mesh(self, performance: Performance, folder: Path) -> None:
        production, subject = self._production, performance.subject
        path = folder / f"{production.meshes}.npy"
        if production.meshes is None or path.is_file():
            return
        mesh = production.hand.mesh(subject.identity, performance.pose, production.mesh_level)
        match production.meshes:
            case "tracked":
                rng = np.random.default_rng([77, subject.look.seed, int(performance.name.removeprefix("pose-"))])
                vertices = mesh.vertices + smooth_noise(mesh.topology, len(mesh.vertices), rng)
            case "scan":
                vertices = displace(mesh, self.skin(subject)).vertices
        with whole(path) as part, part.open("wb") as file:
            np.save(file, vertices.astype(np.float32))


def is_whole(folder: Path, view: RenderTask) -> bool:
    """Whether all files of a view are there."""
    names = (*(lighting.name for lighting in view.lightings), "geometry")
    return all((folder / f"{name}.exr").is_file() for name in names)


def traced(mesh: Mesh, skin: Skin) -> TracedSurface:
    """A surface in its skin, with the skin's relief."""
    return TracedSurface(
        displace(mesh, skin), skin.albedo, skin.roughness, bump=skin.bump, mean_free_path=skin.mean_free_path
    )


def _channels(seen: GBuffer, with_uv: bool) -> dict[str, Array]:
    half, single = np.float16, np.float32
    channels: dict[str, Array] = {"A": seen.alpha.astype(half), "depth.Z": seen.depth.astype(single)}
    channels |= {f"normal.{axis}": seen.normal[..., i].astype(half) for i, axis in enumerate("XYZ")}
    if with_uv:
        channels |= {f"uv.{axis}": seen.uv[..., i].astype(single) for i, axis in enumerate("UV")}
    return channels


def smooth_noise(topology: Topology, count: int, rng: np.random.Generator, rounds: int = 24) -> Array:
    """Smooth random offsets (V, 3) of root mean square length `TRACKING_NOISE`: how trackers err, bumps not grain."""
    faces = topology.faces
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    links = scipy.sparse.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (count, count))
    links = ((links + links.T) > 0).astype(np.float64) + scipy.sparse.eye(count)
    average = scipy.sparse.diags(1.0 / np.asarray(links.sum(axis=1)).ravel()) @ links
    noise = rng.normal(size=(count, 3))
    for _ in range(rounds):
        noise = average @ noise
    return noise * (TRACKING_NOISE / np.sqrt((noise**2).sum(axis=1).mean()))
