"""HARP's optimisation: first shape and poses by the silhouette, then appearance too, then appearance alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from handbench.errors import NonFinite, Unsupported
from handbench.hand.fitting.space import Space
from handbench.hand.skinning import linear_blend
from handbench.hand.twins import completed
from handbench.method import Progress
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import rasterise
from handbench.render.silhouette import seen_at, silhouette
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.unwrap import TexelSurface
from handbench.scene import Array, Mesh

from ..kit.adam import Adam
from ..kit.colourspace import to_display
from ..kit.crop import Crop
from ..kit.enrolled import Enrolled
from ..kit.perceptual import patch, perceptual_loss
from ..kit.rows import rows_of
from . import losses
from .config import HarpConfig
from .look import AMBIENT, LIGHT, SKIN, Look, shade
from .picture import FittedCrop, PixelSamples
from .plateau import Plateau
from .shadow import visibility
from .start import lit_from
from .surface import HandSurface, mapped

_PATIENCE = 40  # epochs without progress after which the rate of shape and poses falls to a tenth
_TELL = 10  # steps
_FEW = 50  # samples that tell a light
_STEEPEST = 0.15  # cosine below which a picture tells nothing of a texel


def fitted(enrolled: Enrolled, config: HarpConfig, seed: int, progress: Progress) -> Look:
    """The look of an enrolment. Raises `Unsupported` if no picture shows it, `NonFinite` if it breaks."""
    return _Fit(enrolled, config, seed).run(progress)


class _Fit:
    def __init__(self, enrolled: Enrolled, config: HarpConfig, seed: int) -> None:
        self.config, self.hand = config, enrolled.hand
        self.surface = HandSurface(enrolled.hand, config.level)
        space = Space.of(enrolled.hand, self.surface.level)
        self._free = torch.zeros(3 * len(enrolled.hand.parents)).index_fill(0, torch.from_numpy(space.free), 1.0)
        self._free = self._free.unflatten(0, (-1, 3))
        self._basis = torch.from_numpy(space.shape_basis).float()
        self._shape = torch.tensor(np.asarray(enrolled.shape, dtype=np.float64)).float()
        self._rest = self.hand.rest_points(self._shape)[1]
        self._weights, self._frames = (
            torch.tensor(part).float() for part in (self.hand.point_weights, self.hand.frames)
        )
        self.pictures = []
        for seen in enrolled.pictures:
            crop = Crop.of(seen.camera, seen.observation.image, seen.observation.alpha, config.side)  # type: ignore[arg-type]
            pose = (seen.pose.joints.copy(), seen.pose.rotation.copy(), seen.pose.translation.copy())
            self.pictures.append(FittedCrop(crop, pose, config))
        size = config.texture
        self._atlas = Atlas.of(self.surface.topology, size)
        self.used = torch.from_numpy(self._atlas.covered)
        self.z = torch.zeros(self._basis.shape[1], requires_grad=True)
        self.offset = torch.zeros(self.surface.count, requires_grad=True)
        self.albedo = torch.tensor(SKIN)[:, None, None].repeat(1, size, size).requires_grad_()
        self.normal_map = torch.tensor([0.0, 0.0, 1.0])[:, None, None].repeat(1, size, size).requires_grad_()
        camera = self.pictures[0].crop.camera
        middle = np.mean([picture.translation.detach().numpy() for picture in self.pictures], axis=0)
        self.light = torch.tensor(middle + np.array(LIGHT) @ camera.rotation).float().requires_grad_()
        self.ambient = torch.tensor(AMBIENT, requires_grad=True)
        self._random = np.random.default_rng([23, seed])
        self._generator = torch.Generator().manual_seed(seed)

    # -- the run ----------------------------------------------------------------------------------------------------

    def run(self, progress: Progress) -> Look:
        config, total = self.config, sum(self.config.steps)
        geometry = [self.z, self.offset, *(part for picture in self.pictures for part in picture.unknowns)]
        appearance = [self.light, self.ambient, self.albedo, self.normal_map]
        shaping, plateau = Adam(geometry, config.rate), Plateau(config.rate, _PATIENCE)
        painting = Adam(appearance, config.appearance_rate)
        with torch.no_grad():
            self._edges = self.surface.lengths(self._vertices(self.pictures[0]))
            for picture in self.pictures:
                picture.points = self._points(picture)
        epoch = max(1, len(self.pictures) // config.batch)
        order, told = self._order(), []
        for step in range(total):
            shapes, paints = step < sum(config.steps[:2]), step >= config.steps[0]
            if step == config.steps[0] and config.start == "seen":
                self._start_from_what_is_seen()
            for optimiser in (shaping, painting):
                optimiser.forget()
            count = min(config.batch, len(self.pictures))
            value = 0.0
            for _ in range(count):
                loss = self._loss(self.pictures[next(order)], shapes, paints) / count
                loss.backward()
                value += float(loss.detach())
            if not np.isfinite(value):
                raise NonFinite(f"harp: the loss of step {step + 1} is {value:g}; lower the rate")
            if shapes:
                shaping.step()
            if paints:
                painting.rate = config.appearance_rate * _falling(config, step - config.steps[0])
                painting.step()
            told.append(value)
            if shapes and (step + 1) % epoch == 0:
                shaping.rate = plateau.after(float(np.mean(told[-epoch:])))
            if (step + 1) % _TELL == 0 or step + 1 == total:
                progress(step + 1, total, loss=float(np.mean(told[-_TELL:])))
        return self._look()

    def _order(self) -> Iterator[int]:
        while True:
            yield from self._random.permutation(len(self.pictures))

    def _look(self) -> Look:
        shape = (self._shape + self._basis @ self.z).detach().double().numpy()
        parts = (self.offset, self.albedo, self.normal_map, self.light, self.ambient)
        offset, albedo, normal_map, light, ambient = (part.detach().clone() for part in parts)
        if self.config.unseen == "completed":
            albedo = self._without_gaps(albedo)
        return Look(self.config, self.surface, shape, offset, albedo, normal_map, light, ambient)

    @torch.no_grad()
    def _without_gaps(self, albedo: Tensor) -> Tensor:
        """The albedo with texels that no picture showed filled in from those that were."""
        seen = np.zeros(self._atlas.count, dtype=bool)
        for picture in self.pictures:
            inner = picture.inner.astype(np.float32)
            seen |= self._texels(picture)[1].project(picture.crop.camera, inner[..., None], inner, _STEEPEST).weight > 0
        return self._completed(self._atlas.gather(albedo).clamp_min(0.0).double().numpy(), seen)

    # -- the surface ------------------------------------------------------------------------------------------------

    def _vertices(self, picture: FittedCrop) -> Tensor:
        return self.surface.posed(*self._pose(picture), self.offset)

    def _pose(self, picture: FittedCrop) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        joints = picture.start + self._free * picture.joints
        return self._shape + self._basis @ self.z, joints, picture.rotation, picture.translation

    def _points(self, picture: FittedCrop) -> Tensor:
        """Key points (21, 3) of a picture from the wrist, metres, of the fitted shape: they anchor the pose."""
        hand, (_, joints, rotation, translation) = self.hand, self._pose(picture)
        heads = self._rest[: len(hand.parents)]
        carried = (self._rest, heads, hand.parents, self._weights, self._frames, joints, rotation, translation)
        chosen = linear_blend(*carried)[list(hand.key_points)]
        return chosen - chosen[:1]

    def _sampled(self, picture: FittedCrop, vertices: Tensor) -> PixelSamples:
        """The picture's samples, cast anew after `refresh` uses."""
        kept = picture.samples
        if kept is None or kept.age >= self.config.refresh:
            mesh = Mesh(vertices.detach().double().numpy(), self.surface.topology)
            found = rasterise(mesh, picture.crop.camera, self.config.supersample)
            inside = np.flatnonzero(picture.inner.ravel()[found.pixel])
            parts = (found.pixel.astype(np.int64), found.face.astype(np.int64), found.barycentric, found.uv)
            pixel, face, barycentric, uv = (torch.from_numpy(part[inside]) for part in parts)
            kept = picture.samples = PixelSamples(pixel, face, barycentric, uv.float())
        kept.age += 1
        return kept

    # -- the losses -------------------------------------------------------------------------------------------------

    def _loss(self, picture: FittedCrop, shapes: bool, paints: bool) -> Tensor:
        weights = self.config.weights
        with torch.set_grad_enabled(shapes):
            vertices = self._vertices(picture)
        total = torch.zeros(())
        if shapes:
            drawn = silhouette(vertices, self.surface.edges, picture.crop.camera)
            total = total + weights.silhouette * (drawn - picture.alpha).abs().mean()
            assert picture.points is not None
            moved = (self._points(picture) - picture.points).square().sum(dim=1)
            total = total + weights.key_points * 100.0 * moved.mean()  # (mm / 100)^2
            total = total + weights.displacement * self.offset.square().sum()
            total = total + weights.laplacian * self.surface.roughness(vertices)
            total = total + weights.normal * self.surface.creases(vertices)
            stretched = (self.surface.lengths(vertices) - self._edges).square().mean()
            total = total + weights.rigid * stretched
        if paints:
            total = total + self._appearance(picture, vertices)
            total = total + weights.albedo * losses.jitter(self.albedo, self.used, losses.ALBEDO_REACH, self._generator)
            total = total + weights.normal_map * losses.normal_regulariser(self.normal_map, self.used, self._generator)
        return total

    def _appearance(self, picture: FittedCrop, vertices: Tensor) -> Tensor:
        """Photometric and perceptual losses. A pixel's point on the surface carries its colour along when the surface
        moves: the colour is compared with the picture at the place where the point is seen."""
        samples, (height, width) = self._sampled(picture, vertices), picture.alpha.shape
        colour, position = self._colour(picture, samples, vertices)
        place = seen_at(position, picture.crop.camera)[0]
        truth = _looked_up(picture.image, place / torch.tensor([width, height]))
        share = 1.0 / self.config.supersample**2
        photometric = share * (colour - truth).abs().sum() / (3 * height * width)
        rows, columns = patch(height, width, self._random)
        blank = torch.zeros(3, height * width)
        drawn, wanted = (
            blank.index_add(1, samples.pixel, share * part).unflatten(1, (height, width))[:, rows, columns]
            for part in (colour, truth.detach())
        )
        perceptual = perceptual_loss(drawn[None], wanted)[0]
        return self.config.weights.photometric * photometric + self.config.weights.perceptual * perceptual

    def _colour(self, picture: FittedCrop, samples: PixelSamples, vertices: Tensor) -> tuple[Tensor, Tensor]:
        """Display colours (3, P) and positions (P, 3) of samples."""
        position, smooth, along = self._at(samples, vertices)
        values = _looked_up(self.normal_map, _flipped(samples.uv)).T
        normal = mapped(smooth, along if self.config.tangents == "uv" else None, values)
        if samples.visible is None:
            mesh = PosedMesh(Mesh(vertices.detach().double().numpy(), self.surface.topology))
            points, light = position.detach().double().numpy(), self.light.detach().double().numpy()
            samples.visible = torch.from_numpy(visibility(mesh, light, points, self.config.shadow_size)).float()
        shading = shade(position, normal, samples.visible, self.light, self.ambient)
        albedo = _looked_up(self.albedo, _flipped(samples.uv))
        return to_display(albedo * shading, self.config.space), position

    def _at(self, samples: PixelSamples, vertices: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Position, smooth unit normal and tangent (P, 3) of samples."""
        corners, share = self.surface.faces[samples.face], samples.barycentric[..., None]
        position = (share * rows_of(vertices, corners)).sum(dim=1)
        smooth = F.normalize((share * rows_of(self.surface.normals(vertices), corners)).sum(dim=1), dim=1)
        return position, smooth, rows_of(self.surface.tangents(vertices), samples.face)

    # -- the start --------------------------------------------------------------------------------------------------

    @torch.no_grad()
    def _start_from_what_is_seen(self) -> None:
        """Light, ambient share, then albedo by least squares of the pictures."""
        shown, facing = [], []
        for picture in self.pictures:
            vertices = self._vertices(picture)
            samples = self._sampled(picture, vertices)
            facing.append(self._at(samples, vertices)[1])
            shown.append(picture.colour.flatten(1)[:, samples.pixel])
        normal, colour = torch.cat(facing).numpy(), torch.cat(shown, dim=1)
        if len(normal) < _FEW:
            raise Unsupported("no enrolled picture shows the inside of the hand where its pose was found")
        share, towards = lit_from(normal, colour.mean(dim=0).numpy())
        middle = torch.stack([picture.translation for picture in self.pictures]).mean(dim=0)
        self.light.copy_(middle + (self.light - middle).norm() * torch.from_numpy(towards).float())
        self.ambient.fill_(float(np.log(share / (1.0 - share))))
        self.albedo.copy_(self._unshaded())

    def _unshaded(self) -> Tensor:
        """The albedo (3, R, R) that explains the pictures' texels best in the light as it is (least squares)."""
        atlas = self._atlas
        total, weight = np.zeros((3, atlas.count)), np.zeros(atlas.count)
        for picture in self.pictures:
            mesh, surface = self._texels(picture)
            shown = surface.project(picture.crop.camera, picture.model, picture.inner.astype(np.float32), _STEEPEST)
            lit = visibility(mesh, self.light.numpy(), surface.position, self.config.shadow_size)
            position, normal, visible = (
                torch.from_numpy(part).float() for part in (surface.position, surface.normal, lit)
            )
            shading = shade(position, normal, visible, self.light, self.ambient).numpy()
            total += shown.weight * shading * shown.colour
            weight += shown.weight * shading**2
        return self._completed(total / np.maximum(weight, 1e-9), weight > 0)

    def _texels(self, picture: FittedCrop) -> tuple[PosedMesh, TexelSurface]:
        mesh = PosedMesh(Mesh(self._vertices(picture).double().numpy(), self.surface.topology))
        return mesh, TexelSurface.of(mesh, self._atlas)

    def _completed(self, colour: Array, seen: Array) -> Tensor:
        """A map (3, R, R) of colours (3, N) of which only some were seen."""
        if not seen.any():
            raise Unsupported("no enrolled picture shows the hand where its pose was found")
        filled = completed(self.hand, self.surface.level, self._atlas, colour, seen).colour
        return self._atlas.dilate(self._atlas.scatter(torch.from_numpy(filled).float()))


def _falling(config: HarpConfig, step: int) -> float:
    """Of the appearance's rate at a step: all of it, or with `decay` a cosine's share."""
    return 0.5 + 0.5 * float(np.cos(np.pi * min(1.0, step / sum(config.steps[1:])))) if config.decay else 1.0


def _flipped(uv: Tensor) -> Tensor:
    """UVs (N, 2) as places in a texture from its upper left corner, in [0, 1]."""
    return torch.stack([uv[:, 0], 1.0 - uv[:, 1]], dim=1)


def _looked_up(image: Tensor, place: Tensor) -> Tensor:
    """Bilinear values (C, N) of an image (C, H, W) at places (N, 2) in [0, 1] from its upper left corner."""
    grid = (2.0 * place - 1.0)[None, None].to(image.dtype)
    return F.grid_sample(image[None], grid, padding_mode="border", align_corners=False)[0, :, 0]
