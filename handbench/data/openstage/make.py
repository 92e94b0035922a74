"""Generation of the open light stage: path traced view by view, resumable, nothing half-written."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse

from ...errors import InputError, StorageError
from ...files import whole, writing
from ...hand.openhand import OpenHand
from ...method import Progress, silent
from ...scene import Array, Camera, Directional, Environment, Mesh, Topology
from ..exr import rgb, write_exr
from .cast import Performance, Subject, cast
from .inventory import TRACED, content, measured, write_sums
from .presets import GENERATOR_VERSION, SCHEMA, Preset
from .skin import Skin, make_skin
from .stage import Lighting, cameras, lightings
from .trace.llvm import VECTORISED
from .trace.pathtrace import PathTracer, TracedSurface, choose_variant, displace

TRACKING_NOISE = 3e-4  # metres, root mean square distance of a tracked vertex from the true coarse surface


_LATELY = 600.0  # seconds: no file takes as long to write


@dataclass(frozen=True)
class _Production:
    """Everything of a capture that is decided before the first ray."""

    preset: Preset
    hand: OpenHand
    people: list[tuple[Subject, tuple[Performance, ...]]]
    cameras: tuple[Camera, ...]
    lights: tuple[Lighting, ...]
    folder: Path

    @property
    def traced(self) -> list[Lighting]:
        """The lightings that are rendered; the others are sums."""
        return [light for light in self.lights if light.kind in TRACED]

    @property
    def views(self) -> list[Path]:
        """The folder of every view: a pose of a subject in a camera."""
        poses = [self.folder / person.name / act.name for person, acts in self.people for act in acts]
        return [pose / camera.name for pose in poses for camera in self.cameras]

    def is_whole(self, view: Path) -> bool:
        names = (*(light.name for light in self.traced), "geometry")
        return all((view / f"{name}.exr").is_file() for name in names)


def make(preset: Preset, folder: Path, progress: Progress = silent, variant: str | None = None) -> None:
    """Generate what is missing of a capture in `folder`; its capture.json is written last.

    Raises `StorageError` when the folder cannot be written or the disk is full; what is there stays.
    """
    with writing(folder, "free some space or choose another folder"):
        folder.mkdir(parents=True, exist_ok=True)
        hand = OpenHand.load()
        production = _Production(preset, hand, cast(preset, hand), cameras(preset), lightings(preset), folder)
        _check_space(production)
        _sweep(folder)
        variant = _variant(folder, variant or choose_variant())
        _save_shared(production)
        for done, _ in enumerate(_views(production, PathTracer(variant)), start=1):
            progress(done, len(production.views))
        manifest = _manifest(production, variant)
        sums = measured(folder, manifest)
        write_sums(folder, sums)
        manifest["content"] = content(sums)
        with whole(folder / "capture.json") as part:
            part.write_text(json.dumps(manifest, indent=1))


def _sweep(folder: Path) -> None:
    """Remove what killed processes left half-written. What was touched lately may be another machine's."""
    for part in folder.rglob(".*.part"):
        with suppress(OSError):
            if time.time() - part.stat().st_mtime > _LATELY:
                part.unlink()


def _variant(folder: Path, available: str) -> str:
    """The variant a capture was begun with, so that a resumed one does not mix two; else the available one."""
    note = folder / "variant"
    if not note.is_file():
        with whole(note) as part:
            part.write_text(available)
    begun = note.read_text().strip()
    if begun == VECTORISED and available != VECTORISED:
        raise InputError(f"{folder} was begun with {begun}, which does not work now; install libllvm19 or delete it")
    return begun


def _save_shared(production: _Production) -> None:
    """Topology and environments: what all views have in common."""
    topology = production.hand.topology(production.preset.tracked_level)
    uvs, uv_faces = topology.unwrapped
    with whole(production.folder / "topology.npz") as part, part.open("wb") as file:
        np.savez_compressed(file, faces=topology.faces, uvs=uvs.astype(np.float32), uv_faces=uv_faces)
    place = production.folder / "environments"
    place.mkdir(exist_ok=True)
    for lighting in production.lights:
        if isinstance(lighting.light, Environment):
            write_exr(place / f"{lighting.name}.exr", rgb(lighting.light.radiance, dtype=np.float32))


def _views(production: _Production, tracer: PathTracer) -> Iterator[None]:
    """Make every view that is not whole, one step a view."""
    preset, hand = production.preset, production.hand
    for person, acts in production.people:
        skin: Skin | None = None
        for act in acts:
            folder = production.folder / person.name / act.name
            folder.mkdir(parents=True, exist_ok=True)
            _save_tracked(folder / "tracked.npy", hand, person, act, preset.tracked_level)
            surface: TracedSurface | None = None
            for camera in production.cameras:
                if not production.is_whole(folder / camera.name):
                    skin = skin or make_skin(hand, person.identity, person.look, preset.skin_size)
                    surface = surface or _surface(hand.mesh(person.identity, act.pose, preset.truth_level), skin)
                    _make_view(tracer, surface, camera, production.traced, preset.spp, folder / camera.name)
                yield


def _surface(mesh: Mesh, skin: Skin) -> TracedSurface:
    return TracedSurface(displace(mesh, skin), skin.albedo, skin.roughness, bump=skin.bump)


def _make_view(
    tracer: PathTracer, surface: TracedSurface, camera: Camera, lights: list[Lighting], spp: int, folder: Path
) -> None:
    folder.mkdir(exist_ok=True)
    images = tracer.render(surface, camera, [light.light for light in lights], spp=spp, seed=0)
    for light, image in zip(lights, images, strict=True):
        write_exr(folder / f"{light.name}.exr", rgb(np.clip(image, 0.0, 60000.0)))  # float16 ends at 65504
    seen = tracer.gbuffer(surface, camera, spp=16)
    half, single = np.float16, np.float32
    channels: dict[str, Array] = {"A": seen.alpha.astype(half), "depth.Z": seen.depth.astype(single)}
    channels |= {f"normal.{axis}": seen.normal[..., i].astype(half) for i, axis in enumerate("XYZ")}
    channels |= {f"uv.{axis}": seen.uv[..., i].astype(single) for i, axis in enumerate("UV")}
    write_exr(folder / "geometry.exr", channels)


def _save_tracked(path: Path, hand: OpenHand, person: Subject, act: Performance, level: int) -> None:
    if path.is_file():
        return
    vertices = hand.mesh(person.identity, act.pose, level).vertices
    rng = np.random.default_rng([77, person.look.seed, int(act.name.removeprefix("pose-"))])
    noisy = vertices + smooth_noise(hand.topology(level), len(vertices), rng)
    with whole(path) as part, part.open("wb") as file:
        np.save(file, noisy.astype(np.float32))


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


def _check_space(production: _Production) -> None:
    """Refuse early when the disk cannot hold what is missing: half floats, compressed to about half."""
    preset, folder = production.preset, production.folder
    images = sum(not production.is_whole(view) for view in production.views) * (len(production.traced) + 3)
    need = images * preset.height * preset.width * 3
    free = shutil.disk_usage(folder).free
    if free < need:
        raise StorageError(
            f"{folder} has {free / 1e9:.2f} GB free, openstage {preset.name} needs about {need / 1e9:.2f} GB more; "
            "free some space or keep captures elsewhere"
        )


def _manifest(production: _Production, variant: str) -> dict[str, Any]:
    """What a reader needs beside the images; numbers as plain lists."""
    lights = production.lights
    return {
        "schema": SCHEMA,
        "generator": GENERATOR_VERSION,
        "preset": asdict(production.preset),
        "recipe": production.preset.recipe,
        "variant": variant,
        "joints": list(production.hand.joint_names),
        "cameras": [
            {
                "name": camera.name,
                "width": camera.width,
                "height": camera.height,
                "K": camera.K.tolist(),
                "world_to_camera": camera.world_to_camera.tolist(),
            }
            for camera in production.cameras
        ],
        "olat": [
            {"direction": light.light.direction.tolist(), "irradiance": light.light.irradiance.tolist()}
            for light in lights
            if isinstance(light.light, Directional)
        ],
        "lightings": [
            {
                "name": light.name,
                "kind": light.kind,
                "weights": None if light.weights is None else light.weights.tolist(),
            }
            for light in lights
        ],
        "subjects": [
            {
                "name": person.name,
                "look": asdict(person.look),
                "poses": [
                    {
                        "name": act.name,
                        "segment": act.segment,
                        "joints": act.pose.joints.tolist(),
                        "rotation": act.pose.rotation.tolist(),
                        "translation": act.pose.translation.tolist(),
                    }
                    for act in acts
                ],
            }
            for person, acts in production.people
        ],
    }
