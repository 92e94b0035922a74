"""Light transfer of one person, texel by texel: least squares over training light, without a network or a paper.

A texel answers to light as to its spherical harmonics in the texel's own frame, colour(t) = sum_i c_i(t) L_i(t), so
what it learned turns with the surface: shadows, bounces and scattering of the training poses are in c. The answer
does not depend on the camera, and it is linear in the light, whatever light that is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, partial

import numpy as np
import torch

from handbench.errors import Unsupported, unknown_name
from handbench.light.harmonics import cosine_lobe, harmonics, turned
from handbench.light.lightset import LightSet, light_samples
from handbench.method import Avatar, Method, MethodInfo, PosedAvatar, Progress, Recording, silent
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import rasterise
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.surface import unit_rows
from handbench.render.uv.unwrap import TexelSurface
from handbench.scene import KNOWN_LIGHTS, Array, Camera, Frame, Light, Prediction, Viewpoint, needed
from handbench.settings import UNCHANGED, Changes, changed

from .kit.picture import prediction
from .kit.untaught import Untaught


@dataclass(frozen=True)
class TransferConfig:
    """texture: side in texels; degree of the harmonics, at most 3; held: weight, in pictures, of what every texel would
    answer if it were matt and of its mean colour: what little light was seen from is that."""

    texture: int = 128
    degree: int = 3
    held: float = 0.5


INFO = MethodInfo(
    name="transfer",
    title="SH transfer",
    summary="per texel, least squares of a spherical-harmonic transfer over one person's training light",
    linear=True,
    needs=frozenset({"image", "alpha", "camera", "mesh", "uv", "light", "olat or group"}),
    lights=KNOWN_LIGHTS,
    fidelity="reference: no learned network",
)


@dataclass(frozen=True)
class TexelFrames:
    """Positions (N, 3) of the texels of a posed mesh, and in each an orthonormal frame (N, 3, 3) that turns with the
    surface: rows tangent, bitangent, normal. Light is told in harmonics up to a degree."""

    position: Array
    axes: Array
    degree: int

    @staticmethod
    def of(mesh: PosedMesh, atlas: Atlas, degree: int) -> TexelFrames:
        normal = unit_rows(atlas.interpolate(mesh.normals))
        uvs, uv_faces = mesh.topology.unwrapped
        corners, places = mesh.vertices[mesh.topology.faces[atlas.face]], uvs[uv_faces[atlas.face]]
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        u, v = places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]
        side = np.sign(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        # up to its length the derivative by the texture's first axis
        along = side[:, None] * (a * v[:, 1:] - b * u[:, 1:])
        tangent = unit_rows(along - (along * normal).sum(axis=1, keepdims=True) * normal)
        axes = np.stack([tangent, np.cross(normal, tangent), normal], axis=1)
        return TexelFrames(atlas.interpolate(mesh.vertices), axes, degree)

    def light(self, lights: LightSet) -> Array:
        """The harmonics (N, K, 3) of lights as each texel sees them, in its own frame.

        Distant lights are the same for all texels: their sum is turned into each frame, however many they are.
        """
        distant = harmonics(lights.directions, self.degree).T @ lights.irradiance
        found = np.concatenate([turn @ distant[d * d : (d + 1) ** 2] for d, turn in enumerate(self._turned)], axis=1)
        for place, intensity in zip(lights.positions, lights.intensities, strict=True):
            towards = place - self.position
            far2 = np.maximum((towards**2).sum(axis=1), 1e-8)
            local = np.einsum("nij,nj->ni", self.axes, towards / np.sqrt(far2)[:, None])
            found += harmonics(local, self.degree)[..., None] * (intensity / far2[:, None])[:, None, :]
        return found

    @cached_property
    def _turned(self) -> list[Array]:
        return turned(self.axes, self.degree)


class TransferAvatar(Avatar):
    """A person's transfer (N, K, 3) at the texels of an atlas."""

    def __init__(self, transfer: Array, config: TransferConfig) -> None:
        self._transfer, self._config = transfer, config

    def pose(self, viewpoint: Viewpoint) -> PosedAvatar:
        mesh = PosedMesh.of(needed(viewpoint.mesh, "mesh"))
        if Atlas.of(mesh.topology, self._config.texture).count != len(self._transfer):
            raise Unsupported(f"{viewpoint.pose_key} has a mesh of another topology than the training frames")
        return PosedTransfer(self._transfer, self._config, mesh, viewpoint.camera)


class PosedTransfer(PosedAvatar):
    """The texels' frames, and what the camera sees of them; `frames` are those that another camera saw."""

    def __init__(
        self,
        transfer: Array,
        config: TransferConfig,
        mesh: PosedMesh,
        camera: Camera,
        frames: TexelFrames | None = None,
    ) -> None:
        self._transfer, self._config, self._mesh = transfer, config, mesh
        self._atlas = Atlas.of(mesh.topology, config.texture)
        self._frames = frames or TexelFrames.of(mesh, self._atlas, config.degree)
        self._raster = rasterise(mesh, camera)

    def seen_by(self, camera: Camera) -> PosedAvatar:
        return PosedTransfer(self._transfer, self._config, self._mesh, camera, self._frames)

    def relight(self, light: Light) -> Prediction:
        seen = self._frames.light(light_samples(light))
        colour = torch.from_numpy(np.einsum("nkc,nkc->cn", self._transfer, seen)).float()
        return prediction(self._raster, self._atlas.dilate(self._atlas.scatter(colour)))


def solved(recording: Recording, config: TransferConfig, progress: Progress = silent) -> Array:
    """The transfer (N, K, 3) of one person from pictures under few known lights.

    Raises `Unsupported` if there are none.
    """
    frames = recording.of_kind("olat", "group").frames
    if not frames:
        raise Unsupported("transfer is solved from frames with few lights, and the subject has none")
    atlas = Atlas.of(needed(frames[0].mesh, "mesh").topology, config.texture)
    size = (config.degree + 1) ** 2
    normal, right = np.zeros((atlas.count, 3, size, size)), np.zeros((atlas.count, 3, size))
    seen_light = np.zeros(())
    for weight, light, colour in _pictures(recording, frames, atlas, config, progress):
        on = np.flatnonzero(weight)  # half of the hand and more is turned away
        each, weight = np.moveaxis(light[on], -1, 1), weight[on]  # (n, 3, K)
        white = bool((each == each[:, :1]).all())  # what light of one colour takes of the work is the same in each
        lit = each[:, :1] if white else each
        normal[on] += weight[:, None, None, None] * lit[..., :, None] * lit[..., None, :]
        right[on] += weight[:, None, None] * each * colour.T[on, :, None]
        seen_light = seen_light + (weight[:, None, None] * each**2).sum(axis=(0, 1)) / max(weight.sum(), 1e-12)
    matt = _matt(normal, right, config.degree)
    power = float(seen_light.mean()) / len(frames)
    hold = config.held * max(power, 1e-12)
    held = normal + hold * np.eye(size)
    return np.moveaxis(np.linalg.solve(held, (right + hold * matt)[..., None])[..., 0], 1, 2)


def _matt(normal: Array, right: Array, degree: int) -> Array:
    """The transfer (N, 3, K) of the matt surface that explains each texel best; unseen ones have the mean colour."""
    lobe = harmonics(np.array([0.0, 0.0, 1.0]), degree) * cosine_lobe(degree)
    top, bottom = right @ lobe, np.einsum("nckl,k,l->nc", normal, lobe, lobe)
    mean = np.maximum(top.sum(axis=0), 0.0) / np.maximum(bottom.sum(axis=0), 1e-12)
    few = 0.05 * bottom.mean(axis=0)
    albedo = np.maximum(top + few * mean, 0.0) / np.maximum(bottom + few, 1e-12)
    return albedo[..., None] * lobe


def _pictures(
    recording: Recording, frames: Sequence[Frame], atlas: Atlas, config: TransferConfig, progress: Progress
) -> Iterator[tuple[Array, Array, Array]]:
    """Of each picture the texels' weights (N,), their light (N, K, 3) and their colours (3, N)."""
    pose, surface, axes = "", None, None
    lit: dict[str, Array] = {}
    for step, frame in enumerate(sorted(frames, key=lambda frame: frame.pose_key), start=1):
        if surface is None or frame.pose_key != pose:
            posed = PosedMesh.of(needed(frame.mesh, "mesh"))
            pose, surface, axes, lit = (
                frame.pose_key,
                TexelSurface.of(posed, atlas),
                TexelFrames.of(posed, atlas, config.degree),
                {},
            )
        assert axes is not None
        if frame.lighting not in lit:
            lit[frame.lighting] = axes.light(light_samples(frame.light))
        seen = recording.observe(frame)
        shown = surface.project(frame.camera, seen.image, needed(seen.alpha, "alpha"))
        yield shown.weight, lit[frame.lighting], shown.colour
        progress(step, len(frames))


class Transfer(Untaught):
    def __init__(self, config: TransferConfig) -> None:
        super().__init__(INFO, asdict(config), partial(_personalised, config))


def _personalised(config: TransferConfig, enrolment: Recording, seed: int, progress: Progress) -> Avatar:
    return TransferAvatar(solved(enrolment, config, progress), config)


PRESETS = {
    "smoke": TransferConfig(texture=64, degree=2),
    "quick": TransferConfig(),
    "standard": TransferConfig(texture=256),
    "paper": TransferConfig(texture=512),  # of 1 GB and more: larger ones take too much memory
}


def create(preset: str = "quick", changes: Changes = UNCHANGED) -> Method:
    """The method at a preset with changed settings; `InputError` for unknown ones."""
    if preset not in PRESETS:
        raise unknown_name("preset of transfer", preset, PRESETS)
    return Transfer(changed(PRESETS[preset], changes, "transfer"))
