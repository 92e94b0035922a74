"""UHM's adaptation to a person: shadows of every picture, the texture without them, and its refinement."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from handbench.errors import NonFinite, Unsupported
from handbench.hand.twins import completed
from handbench.method import Progress
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.raster import Raster, rasterise
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.unwrap import TexelSurface
from handbench.scene import Array, Mesh, Pose

from ..kit.adam import Adam
from ..kit.colourspace import to_display, to_model
from ..kit.crop import Crop
from ..kit.enrolled import Enrolled, PosedPicture
from ..kit.perceptual import patch, perceptual_loss
from .config import UhmConfig

_LEAST = 1e-4  # added to a shadow before it divides
_START = 2.0  # of the shadows before the sigmoid: 0.88, hardly any
_EATEN = 1  # times the mask's edge is eaten by 5 x 5 before it is unwrapped
_FULL = 1024  # texels a side for which the weight of total variation is told
_TELL = 10  # steps


@dataclass(frozen=True, eq=False)
class Adapted:
    """A person as UHM's adaptation leaves them: a hand, a texture without shadows, and the shadows it was seen in.

    texture (3, N) in the colours of `config.space`, at the covered texels of an atlas of `config.texture`; shadows
    (T, N) in [0, 1] of T pictures, normals (T, N, 3) of the surface in them, and which texels each shows, seen (T, N).
    """

    config: UhmConfig
    hand: Enrolled
    texture: Tensor
    shadows: Tensor
    normals: Tensor
    seen: Tensor

    def mesh(self, pose: Pose) -> Mesh:
        """The hand in a pose."""
        return self.hand.mesh(pose, min(self.config.level, self.hand.hand.levels))


@dataclass(eq=False)
class _Picture:
    """A crop, its display values (3, h, w), the raster of the posed hand in it, and what it shows of the texture:
    colour (3, N), seen (N,), normal (N, 3)."""

    crop: Crop
    image: Tensor
    mask: Tensor
    raster: Raster
    colour: Tensor
    seen: Tensor
    normal: Tensor


def adapted(enrolled: Enrolled, config: UhmConfig, seed: int, progress: Progress) -> Adapted:
    """The person of an enrolment whose identity and poses were fitted.

    1. The mean foreground colour c of all pictures; shadow maps S_t, each its own unknown with a sigmoid, by L1 and
       perceptual distance of c S_t to the picture, 0.1 BCE(S_t -> 1) and 100 TV(S_t)^2 (the seed's and UHM's losses).
       UHM's ShadowNet predicts S_t from the pose; maps of their own need no training and are as smooth.
    2. Texture: mean of I_t / (S_t + 1e-4) over the pictures that show a texel; unseen ones are filled in along the
       skin (UHM: Telea's in-painting of the texture image).
    3. Texture refined by 10 (L1 + perceptual) of its picture in those shadows, and total variation where nothing was
       seen. UHM goes on with pose and shadow networks at a rate of 1e-5; here they stay.
    Raises `Unsupported` if no picture shows the hand, `NonFinite` if an optimisation breaks.
    """
    return _Adaptation(enrolled, config, seed).run(progress)


class _Adaptation:
    def __init__(self, enrolled: Enrolled, config: UhmConfig, seed: int) -> None:
        self.config, self.enrolled = config, enrolled
        self.hand, self.level = enrolled.hand, min(config.level, enrolled.hand.levels)
        self.atlas = Atlas.of(self.hand.topology(self.level), config.texture)
        self.pictures = [self._picture(seen) for seen in enrolled.pictures]
        self.seen = torch.stack([picture.seen for picture in self.pictures])
        if not self.seen.any():
            raise Unsupported("no enrolled picture shows the hand where its pose was found")
        self._random = np.random.default_rng([29, seed])
        self._weight = config.weights.variation * (config.texture / _FULL) ** 2

    def _picture(self, seen: PosedPicture) -> _Picture:
        observation, config = seen.observation, self.config
        assert observation.alpha is not None
        crop = Crop.of(seen.camera, observation.image, observation.alpha, config.side)
        mesh = PosedMesh(self.enrolled.mesh(seen.pose, self.level))
        model = to_model(crop.image, config.space)
        surface = TexelSurface.of(mesh, self.atlas)
        shown = surface.project(crop.camera, model, crop.inner(_EATEN, 5).astype(np.float32))
        raster = rasterise(mesh, crop.camera, 2)
        mask = torch.from_numpy((raster.alpha > 0.99) & crop.inner(0))
        image = to_display(torch.from_numpy(np.moveaxis(model, -1, 0).copy()), config.space)
        colour, normal = (torch.from_numpy(part).float() for part in (shown.colour, surface.normal))
        return _Picture(crop, image, mask, raster, colour, torch.from_numpy(shown.weight > 0), normal)

    def run(self, progress: Progress) -> Adapted:
        config = self.config
        total = config.shadow_steps + config.refine_steps
        shadows = self._shadows(total, progress)
        texture = self._unwrapped(shadows)
        texture = self._refined(texture, shadows, total, progress)
        normals = torch.stack([picture.normal for picture in self.pictures])
        return Adapted(config, self.enrolled, texture, shadows, normals, self.seen)

    # -- shadows ----------------------------------------------------------------------------------------------------

    def _shadows(self, total: int, progress: Progress) -> Tensor:
        """The shadow maps (T, N)."""
        weights = self.config.weights
        mean = torch.cat([p.colour[:, p.seen] for p in self.pictures], dim=1).mean(dim=1)
        raw = torch.full((len(self.pictures), self.atlas.count), _START, requires_grad=True)
        adam = Adam([raw], self.config.shadow_rate)
        for step in range(self.config.shadow_steps):
            adam.forget()
            shadow = torch.sigmoid(raw)
            loss = self._weight * self._variation(shadow)
            loss = loss + weights.bright * torch.nn.functional.softplus(-raw).mean()  # BCE with a target of one
            for picture, own in zip(self.pictures, shadow, strict=True):
                drawn = mean[:, None, None] * self._drawn(picture, own[None])
                loss = loss + self._picture_loss(picture, drawn) / len(self.pictures)
            _checked(loss, step)
            loss.backward()
            adam.step()
            _tell(progress, step + 1, total, loss)
        return torch.sigmoid(raw).detach()

    def _variation(self, maps: Tensor) -> Tensor:
        """Mean squared differences of maps (..., N) to the texels at the right and above."""
        right, _, up, _ = self.atlas.neighbours(maps.device)
        flat = maps.reshape(-1, maps.shape[-1])
        return sum(((flat.index_select(1, other) - flat) ** 2).mean() for other in (right, up))  # type: ignore[return-value]

    def _drawn(self, picture: _Picture, values: Tensor) -> Tensor:
        return picture.raster.sample(self.atlas.dilate(self.atlas.scatter(values)))

    def _picture_loss(self, picture: _Picture, drawn: Tensor) -> Tensor:
        weights, (height, width) = self.config.weights, picture.mask.shape
        shown, truth = (part * picture.mask for part in (to_display(drawn, self.config.space), picture.image))
        loss = weights.photometric * (shown - truth).abs().mean()
        rows, columns = patch(height, width, self._random)
        return loss + weights.perceptual * perceptual_loss(shown[None, :, rows, columns], truth[:, rows, columns])[0]

    # -- texture ----------------------------------------------------------------------------------------------------

    def _unwrapped(self, shadows: Tensor) -> Tensor:
        """The mean of the pictures without their shadows (3, N), what none showed filled in."""
        total, count = torch.zeros(3, self.atlas.count), self.seen.sum(dim=0)
        for picture, shadow in zip(self.pictures, shadows, strict=True):
            total += picture.seen * picture.colour / (shadow + _LEAST)
        mean: Array = (total / count.clamp_min(1)).double().numpy()
        filled = completed(self.hand, self.level, self.atlas, mean, (count > 0).numpy())
        return torch.from_numpy(filled.colour).float()

    def _refined(self, texture: Tensor, shadows: Tensor, total: int, progress: Progress) -> Tensor:
        """The texture (3, N) after its refinement."""
        texture = texture.clone().requires_grad_()
        adam = Adam([texture], self.config.refine_rate)
        right, _, up, _ = self.atlas.neighbours(texture.device)
        unseen = ~self.seen.any(dim=0)
        order, steps = self._order(), self.config.refine_steps
        for step in range(steps):
            adam.forget()
            which = next(order)
            drawn = self._drawn(self.pictures[which], texture * shadows[which])
            loss = self.config.weights.refined * self._picture_loss(self.pictures[which], drawn)
            for other in (right, up):
                loss = loss + self._weight * (unseen * (texture.index_select(1, other) - texture) ** 2).mean()
            _checked(loss, step)
            loss.backward()
            adam.rate = self.config.refine_rate * (1.0 - self.config.decay * step / steps)
            adam.step()
            _tell(progress, self.config.shadow_steps + step + 1, total, loss)
        return texture.detach().clamp_min(0.0)

    def _order(self) -> Iterator[int]:
        while True:
            yield from self._random.permutation(len(self.pictures))


def _checked(loss: Tensor, step: int) -> None:
    if not bool(loss.detach().isfinite()):
        raise NonFinite(f"uhm: the loss of step {step + 1} is {float(loss.detach()):g}; lower the rate")


def _tell(progress: Progress, step: int, total: int, loss: Tensor) -> None:
    if step % _TELL == 0 or step == total:
        progress(step, total, loss=float(loss.detach()))
