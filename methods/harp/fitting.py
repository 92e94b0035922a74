"""HARP's optimisation: first shape and poses by the silhouette, then appearance too, then appearance alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

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

from ..kit.closeup import CloseUp
from ..kit.colourspace import to_display, to_model
from ..kit.enrolled import Enrolled
from ..kit.perceptual import patch, perceptual_loss
from . import losses
from .config import HarpConfig
from .look import AMBIENT, LIGHT, SKIN, Look, shade
from .shadow import visibility
from .surface import Surface, mapped

_EATEN = 2  # times the mask's edge is eaten by 3 x 3 before colours are compared
_PATIENCE = 40  # epochs without progress after which the rate of shape and poses falls to a tenth
_TELL = 10  # steps
_STEEPEST = 0.15  # cosine below which a picture tells nothing of a texel


def fitted(enrolled: Enrolled, config: HarpConfig, seed: int, progress: Progress) -> Look:
    """The look of an enrolment. Raises `Unsupported` if no picture shows it, `NonFinite` if it breaks."""
    return _Fit(enrolled, config, seed).run(progress)


@dataclass(eq=False)
class _Samples:
    """Pixels (P,) inside a close-up's mask that the surface covers, and where on the surface they are."""

    pixel: Tensor
    face: Tensor
    barycentric: Tensor
    uv: Tensor
    age: int = 0
    visible: Tensor | None = None


class _Picture:
    """A close-up, its colours (3, h, w) in the model's space and as display values, and the unknown pose."""

    def __init__(self, close: CloseUp, pose: tuple[Array, Array, Array], config: HarpConfig) -> None:
        self.close = close
        self.start = torch.tensor(pose[0]).float()
        self.joints = torch.zeros_like(self.start, requires_grad=True)
        self.rotation, self.translation = (torch.tensor(part).float().requires_grad_() for part in pose[1:])
        model = np.moveaxis(to_model(close.image, config.space), -1, 0)
        self.colour = torch.from_numpy(np.ascontiguousarray(model))
        self.image = to_display(self.colour, config.space)
        self.alpha = torch.from_numpy(close.alpha)
        self.inner = close.inner(_EATEN)
        self.points: Tensor | None = None
        self.samples: _Samples | None = None

    @property
    def unknowns(self) -> list[Tensor]:
        return [self.joints, self.rotation, self.translation]


class _Fit:
    def __init__(self, enrolled: Enrolled, config: HarpConfig, seed: int) -> None:
        self.config, self.hand = config, enrolled.hand
        self.surface = Surface(enrolled.hand, config.level, enrolled.size)
        space = Space.of(enrolled.hand, self.surface.level)
        self._free = torch.zeros(3 * len(enrolled.hand.parents)).index_fill(0, torch.from_numpy(space.free), 1.0)
        self._free = self._free.unflatten(0, (-1, 3))
        self._basis = torch.from_numpy(space.shape_basis).float()
        self._shape = torch.tensor(np.asarray(enrolled.shape, dtype=np.float64)).float()
        self._weights = torch.tensor(self.hand.point_weights).float()
        self.pictures = []
        for seen in enrolled.pictures:
            close = CloseUp.of(seen.camera, seen.observation.image, seen.observation.alpha, config.side)  # type: ignore[arg-type]
            pose = (seen.pose.joints.copy(), seen.pose.rotation.copy(), seen.pose.translation.copy())
            self.pictures.append(_Picture(close, pose, config))
        size = config.texture
        self.used = torch.from_numpy(Atlas.of(self.surface.topology, size).covered)
        self.z = torch.zeros(self._basis.shape[1], requires_grad=True)
        self.offset = torch.zeros(self.surface.count, requires_grad=True)
        self.albedo = torch.tensor(SKIN)[:, None, None].repeat(1, size, size).requires_grad_()
        self.normal_map = torch.tensor([0.0, 0.0, 1.0])[:, None, None].repeat(1, size, size).requires_grad_()
        camera = self.pictures[0].close.camera
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
        shaping = torch.optim.Adam(geometry, config.rate)
        painting = torch.optim.Adam(appearance, config.appearance_rate)
        plateau = torch.optim.lr_scheduler.ReduceLROnPlateau(shaping, patience=_PATIENCE)
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
                optimiser.zero_grad(set_to_none=True)
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
                painting.step()
            told.append(value)
            if shapes and (step + 1) % epoch == 0:
                plateau.step(float(np.mean(told[-epoch:])))
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
            albedo = self._completed(albedo)
        return Look(self.config, self.surface, shape, offset, albedo, normal_map, light, ambient)

    @torch.no_grad()
    def _completed(self, albedo: Tensor) -> Tensor:
        """The albedo with texels that no picture showed filled in from those that were."""
        atlas = Atlas.of(self.surface.topology, self.config.texture)
        seen = np.zeros(atlas.count, dtype=bool)
        for picture in self.pictures:
            mesh = PosedMesh(Mesh(self._vertices(picture).double().numpy(), self.surface.topology))
            close, inner = picture.close, picture.inner.astype(np.float32)
            shown = TexelSurface.of(mesh, atlas).project(close.camera, inner[..., None], inner, _STEEPEST)
            seen |= shown.weight > 0
        if not seen.any():
            raise Unsupported("no enrolled picture shows the hand where its pose was found")
        flat = atlas.gather(albedo).clamp_min(0.0).double().numpy()
        filled = completed(self.hand, self.surface.level, atlas, flat, seen).colour
        return atlas.scatter(torch.from_numpy(filled).float())

    # -- the surface ------------------------------------------------------------------------------------------------

    def _vertices(self, picture: _Picture) -> Tensor:
        return self.surface.posed(*self._pose(picture), self.offset)

    def _pose(self, picture: _Picture) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        joints = picture.start + self._free * picture.joints
        return self._shape + self._basis @ self.z, joints, picture.rotation, picture.translation

    def _points(self, picture: _Picture) -> Tensor:
        """Key points (21, 3) of a picture from the wrist, metres."""
        shape, joints, rotation, translation = self._pose(picture)
        hand = self.hand
        _, points = hand.rest_points(shape)
        heads = points[: len(hand.parents)]
        frames = torch.tensor(hand.frames).float()
        moved = linear_blend(points, heads, hand.parents, self._weights, frames, joints, rotation, translation)
        chosen = self.surface.size * moved[list(hand.key_points)]
        return chosen - chosen[:1]

    def _sampled(self, picture: _Picture, vertices: Tensor) -> _Samples:
        """The picture's samples, cast anew after `refresh` uses."""
        kept = picture.samples
        if kept is None or kept.age >= self.config.refresh:
            mesh = Mesh(vertices.detach().double().numpy(), self.surface.topology)
            found = rasterise(mesh, picture.close.camera, 1)
            inside = np.flatnonzero(picture.inner.ravel()[found.pixel])
            parts = (found.pixel.astype(np.int64), found.face.astype(np.int64), found.barycentric, found.uv)
            pixel, face, barycentric, uv = (torch.from_numpy(part[inside]) for part in parts)
            kept = picture.samples = _Samples(pixel, face, barycentric, uv.float())
        kept.age += 1
        return kept

    # -- the losses -------------------------------------------------------------------------------------------------

    def _loss(self, picture: _Picture, shapes: bool, paints: bool) -> Tensor:
        weights = self.config.weights
        with torch.set_grad_enabled(shapes):
            vertices = self._vertices(picture)
        total = torch.zeros(())
        if shapes:
            drawn = silhouette(vertices, self.surface.edges, picture.close.camera)
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

    def _appearance(self, picture: _Picture, vertices: Tensor) -> Tensor:
        """Photometric and perceptual losses. A pixel's point on the surface carries its colour along when the surface
        moves: the colour is compared with the picture at the place where the point is seen."""
        samples, (height, width) = self._sampled(picture, vertices), picture.alpha.shape
        colour, position = self._colour(picture, samples, vertices)
        place = seen_at(position, picture.close.camera)[0]
        truth = _looked_up(picture.image, place / torch.tensor([width, height]))
        photometric = (colour - truth).abs().sum() / (3 * height * width)
        rows, columns = patch(height, width, self._random)
        blank = torch.zeros(3, height * width)
        drawn, wanted = (
            blank.index_copy(1, samples.pixel, part).unflatten(1, (height, width))[:, rows, columns]
            for part in (colour, truth.detach())
        )
        perceptual = perceptual_loss(drawn[None], wanted)[0]
        return self.config.weights.photometric * photometric + self.config.weights.perceptual * perceptual

    def _colour(self, picture: _Picture, samples: _Samples, vertices: Tensor) -> tuple[Tensor, Tensor]:
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

    def _at(self, samples: _Samples, vertices: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Position, smooth unit normal and tangent (P, 3) of samples."""
        corners, share = self.surface.faces[samples.face], samples.barycentric[..., None]
        position = (share * vertices[corners]).sum(dim=1)
        smooth = F.normalize((share * self.surface.normals(vertices)[corners]).sum(dim=1), dim=1)
        return position, smooth, self.surface.tangents(vertices)[samples.face]

    # -- the start --------------------------------------------------------------------------------------------------

    @torch.no_grad()
    def _start_from_what_is_seen(self) -> None:
        """Light where brightness grows along normals, and the pictures' mean colour over the mean shading as albedo."""
        shown, facing = [], []
        for picture in self.pictures:
            vertices = self._vertices(picture)
            samples = self._sampled(picture, vertices)
            _, smooth, _ = self._at(samples, vertices)
            facing.append(smooth)
            shown.append(picture.colour.flatten(1)[:, samples.pixel])
        normal, colour = torch.cat(facing), torch.cat(shown, dim=1)
        if not len(normal):
            raise Unsupported("no enrolled picture shows the inside of the hand; are the masks right?")
        terms = torch.cat([torch.ones(len(normal), 1), normal], dim=1).double()
        grown = torch.linalg.lstsq(terms, colour.mean(dim=0).double()[:, None]).solution[1:, 0].float()
        if float(grown.norm()) > 1e-4:
            middle = torch.stack([picture.translation for picture in self.pictures]).mean(dim=0)
            distance = (self.light - middle).norm()
            self.light.copy_(middle + distance * F.normalize(grown, dim=0))
        every = torch.ones(len(normal))
        middle = torch.stack([picture.translation for picture in self.pictures]).mean(dim=0)
        shading = shade(middle.expand(len(normal), 3), normal, every, self.light, self.ambient).mean()
        self.albedo.copy_((colour.mean(dim=1) / shading)[:, None, None].expand_as(self.albedo))


def _flipped(uv: Tensor) -> Tensor:
    """UVs (N, 2) as places in a texture from its upper left corner, in [0, 1]."""
    return torch.stack([uv[:, 0], 1.0 - uv[:, 1]], dim=1)


def _looked_up(image: Tensor, place: Tensor) -> Tensor:
    """Bilinear values (C, N) of an image (C, H, W) at places (N, 2) in [0, 1] from its upper left corner."""
    grid = (2.0 * place - 1.0)[None, None].to(image.dtype)
    return F.grid_sample(image[None], grid, padding_mode="border", align_corners=False)[0, :, 0]
