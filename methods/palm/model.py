"""What PALM-Net's prior learns: three fields that all people share, a code for each, and the studio's light."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from handbench.hand import HandModel
from handbench.hand.canonical import WeightField
from handbench.render.volume import Shell, laplace_density

from .config import PalmConfig
from .encoding import Encoding, HashGrid, TriPlane
from .fields import Geometry, GeometryField, MaterialField, RadianceField
from .light import StudioLight
from .reflectance import Material

_LEAST_BETA = 1e-4
_HASTE = 10.0  # times faster than at Adam's rate the logarithm of beta may change


class LatentCodes(NamedTuple):
    """One person: geometry φ and appearance ψ."""

    geometry: Tensor
    appearance: Tensor


class Conditions(NamedTuple):
    """What the fields are told of a posed hand beside the place: codes (C,) of geometry and of appearance."""

    geometry: Tensor
    appearance: Tensor


class PalmModel(nn.Module):
    """Fields, codes phi (people, φ) and psi (people, ψ), the softness of the surface, and the light of the studio.

    `drawn` counts the steps of training, which schedules and checkpoints read.
    """

    drawn: Tensor

    def __init__(self, config: PalmConfig, hand: HandModel, people: int) -> None:
        super().__init__()
        self.config, self.hand = config, hand
        self.field = WeightField.of(hand, spacing=config.spacing)
        sides = self.field.box[1] - self.field.box[0]
        self.reach = 0.5 * sides.max()  # metres that count as one
        self.aspect = sides / sides.max()
        aspect = self.aspect.tolist()
        code = config.pose + config.shape
        outputs = 1 + config.features
        self.pose = nn.Linear(3 * len(hand.parents), config.pose)
        self.shape = nn.Linear(hand.shape_size, config.shape) if config.shape else None
        self.geometry_field = GeometryField(
            _encoding(config, aspect, None), code + config.phi, config.geometry, config.features
        )
        encoding = _encoding(config, aspect, config.skin_features)
        code += config.psi
        self.radiance_field = RadianceField(encoding, outputs, code, config.appearance, config.modulated)
        self.material_field = MaterialField(
            encoding.size, outputs, code, config.material, config.lipschitz, config.modulated
        )
        self.phi = nn.Parameter(1e-8 * torch.randn(people, config.phi))
        self.psi = nn.Parameter(1e-8 * torch.randn(people, config.psi))
        self.softness = nn.Parameter(torch.tensor(math.log(config.beta) / _HASTE))
        self.light = StudioLight(config.gaussians)
        self._shell: Shell | None = None
        self.register_buffer("drawn", torch.zeros((), dtype=torch.int64))

    def around(self, shape: Tensor) -> WeightField:
        """The field of skinning weights of a person's shape (S,): the shared one, or a field of their own."""
        if self.config.canonical == "shared":
            return self.field
        return WeightField.of(self.hand, shape.detach().numpy(), self.config.spacing)

    def rest_shell(self, field: WeightField) -> Shell:
        """Where the surface may be in canonical space; the shared one is made once."""
        if field is not self.field:
            return self._shell_around(field)
        if self._shell is None:
            self._shell = self._shell_around(field)
        return self._shell

    def _shell_around(self, field: WeightField) -> Shell:
        return Shell.around(field.rest.numpy(), self.hand.topology(field.level).faces, self.config.reach)

    def codes(self, person: int) -> LatentCodes:
        """Those of one of the training's people, in the order in which they first appear."""
        return LatentCodes(self.phi[person], self.psi[person])

    def conditions(self, codes: LatentCodes, shape: Tensor, joints: Tensor) -> Conditions:
        """What the fields see of a person's shape (S,) in a pose (J, 3): not where the hand is in the world."""
        turns = joints.clone()
        turns[0] = 0.0
        seen = [self.pose(turns.flatten())]
        if self.shape is not None:
            neutral = torch.from_numpy(np.asarray(self.hand.neutral(), dtype=np.float32))
            seen.append(self.shape(shape - neutral))
        return Conditions(torch.cat([*seen, codes.geometry]), torch.cat([*seen, codes.appearance]))

    def geometry(self, x: Tensor, conditions: Conditions, gradient: bool = False) -> Geometry:
        """f_g at canonical places (N, 3).

        Places that need a gradient give theirs to the distance, not to the features and not to the distance's gradient.
        """
        place = x.detach()
        if not (gradient or x.requires_grad):
            sdf, feature = self.geometry_field(self._unit(place), self.aspect, conditions.geometry)
            return Geometry(self.reach * sdf, feature, None)
        sdf, feature, slope = self.geometry_field.with_gradient(self._unit(place), self.aspect, conditions.geometry)
        sdf = self.reach * sdf
        if x.requires_grad:
            sdf = sdf + (slope.detach() * (x - place)).sum(dim=1)
        return Geometry(sdf, feature, slope if gradient else None)

    def radiance(self, x: Tensor, feature: Tensor, reflected: Tensor, normal: Tensor, conditions: Conditions) -> Tensor:
        """f_rf at canonical places (N, 3), seen along directions whose mirror images at normals are `reflected`; both
        (N, 3) in the world, where the studio's light is."""
        return self.radiance_field(self._unit(x), feature, reflected, normal, conditions.appearance)

    def material(self, x: Tensor, feature: Tensor, conditions: Conditions) -> Material:
        """f_m at canonical places (N, 3)."""
        return self.material_field(self.radiance_field.encoding(self._unit(x)), feature, conditions.appearance)

    @property
    def beta(self) -> Tensor:
        """Metres: how soft the surface is."""
        return (_HASTE * self.softness).exp() + _LEAST_BETA

    def density(self, sdf: Tensor) -> Tensor:
        """1/m at signed distances in metres."""
        return laplace_density(sdf, self.beta)

    def _unit(self, x: Tensor) -> Tensor:
        low, high = self.field.box
        return 2.0 * (x - low) / (high - low) - 1.0


def _encoding(config: PalmConfig, aspect: list[float], features: int | None) -> Encoding:
    if config.encoding == "hash":
        of_level = features or config.level_features
        return HashGrid(config.levels, of_level, config.table, config.base, config.finest, aspect)
    return TriPlane(config.grids, config.plane, features or config.plane_features, aspect)
