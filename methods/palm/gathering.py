"""The light that places send to a camera under any light: distant and near ones summed, maps as lights or by chance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from handbench.light.lightset import LightSet, light_samples
from handbench.light.spread import ENVIRONMENT_ERROR
from handbench.scene import Environment, Group, Light, known_leaves
from handbench.skips import note, skips

from .directions import Sampling, gather
from .light import LightSampler, MapSampler
from .reflectance import Form, Material, coloured, responses, seen_through
from .scattering import Scattering
from .visibility import Occluder

_PAIRS = 1 << 18
"""Pairs of places and directions that are worked on at once: 1 MB a buffer."""

_KEPT = 608
"""Directions whose shadows are kept: cells and texels of maps of the usual size, 25 MB for 10,000 places."""


@dataclass(frozen=True)
class Gathering:
    """How light is summed when a hand is relit.

    maps        environments become distant lights, most of which are the same for all maps ("lights", see
                `handbench.light.spread`), or are sampled: "strata", "light", "combined", see `directions`
    error       that distant lights may make of a map
    directions  that are sampled (released: 4,096); fresh: for each place, or one set for all of them
    form        of the reflectance
    """

    maps: Sampling | Literal["lights"] = "lights"
    error: float = ENVIRONMENT_ERROR
    directions: int = 512
    fresh: bool = False
    form: Form = "released"
    seed: int = 0


class Gatherer:
    """Places and what hides light from them; what they see of a distant light is kept, as maps share most of theirs."""

    def __init__(self, places: Scattering, occluder: Occluder, how: Gathering) -> None:
        self.places, self._occluder, self._how = places, occluder, how
        self._seen: dict[bytes, Tensor] = {}

    @torch.no_grad()
    def colours(self, light: Light) -> Tensor:
        """Linear colours (R, 3), premultiplied, of the places' rays. Raises `Unsupported` for an unknown light."""
        leaves = tuple(known_leaves(light))
        sampled = [leaf for leaf in leaves if isinstance(leaf, Environment)] if self._how.maps != "lights" else []
        rest = Group(tuple(leaf for leaf in leaves if not any(leaf is other for other in sampled)))
        total = self._lights(light_samples(rest, environment_error=self._how.error))
        for leaf in sampled:
            total = total + self._sampled(MapSampler(leaf))
        return self.places.total(total)

    def _lights(self, lights: LightSet) -> Tensor:
        """Radiance (N, 3) of the places under distant and near lights."""
        places = self.places
        total = torch.zeros_like(places.point)
        towards = torch.from_numpy(np.asarray(lights.directions)).float()
        power = torch.from_numpy(np.asarray(lights.irradiance)).float()
        if len(towards):
            seen = self._shadows(towards)
            for some in self._tiles(len(towards)):
                total[some] = self._answered(some, towards, power, seen[some])
        for position, intensity in zip(np.asarray(lights.positions), np.asarray(lights.intensities), strict=True):
            away = torch.from_numpy(position) - places.point.double()
            distance2 = away.square().sum(dim=1, keepdim=True)
            single = (away / distance2.sqrt()).float()[:, None]
            fallen = (torch.from_numpy(intensity) / distance2).float()[:, None]
            answers = responses(places.normal, places.view, places.material.roughness, single, self._how.form)
            lit = self._occluder.of_near(places.point, position)[:, None]
            total += coloured(places.material, seen_through(answers, lit), fallen)
        return total

    def _sampled(self, sky: LightSampler) -> Tensor:
        """Radiance (N, 3) of the places under a map whose directions are drawn."""
        places, how = self.places, self._how
        assert how.maps != "lights"
        total = torch.zeros_like(places.point)
        rng = np.random.default_rng([59, how.seed])
        alone = how.fresh or how.maps == "combined"
        shared = None if alone else gather(how.maps, sky, how.directions, self._points(slice(0, 1)), how.form, rng)
        for some in self._tiles(how.directions):
            if shared is not None:
                seen = self._occluder.of_all(places.point[some], places.normal[some], shared.directions)
                total[some] = self._answered(some, shared.directions, shared.power, seen)
            else:
                own = gather(how.maps, sky, how.directions, self._points(some), how.form, rng, fresh=True)
                total[some] = self._answered(some, own.directions, own.power, self._each(some, own.directions))
        return total

    def _answered(self, some: slice, towards: Tensor, power: Tensor, seen: Tensor) -> Tensor:
        normal, view, material = self._points(some)
        answers = responses(normal, view, material.roughness, towards, self._how.form)
        return coloured(material, seen_through(answers, seen), power)

    def _points(self, some: slice) -> tuple[Tensor, Tensor, Material]:
        return self.places.normal[some], self.places.view[some], self.places.material.of(some)

    def _tiles(self, directions: int) -> list[slice]:
        step = max(1, _PAIRS // directions)
        return [slice(first, first + step) for first in range(0, len(self.places.ray), step)]

    def _shadows(self, towards: Tensor) -> Tensor:
        """What the places see of distant lights (D, 3): (N, D). Of as many as a map has it is kept."""
        if not skips().known:
            return self._occluder.of_all(self.places.point, self.places.normal, towards)
        keys = [direction.numpy().tobytes() for direction in towards]
        new = torch.tensor([key not in self._seen for key in keys])
        note("shadows known already", new.numel() * len(self.places.ray), int((~new).sum()) * len(self.places.ray))
        seen = torch.empty(len(self.places.ray), len(towards))
        if new.any():
            seen[:, new] = self._occluder.of_all(self.places.point, self.places.normal, towards[new])
        for i, key in enumerate(keys):
            if not new[i]:
                seen[:, i] = self._seen[key]
            elif len(self._seen) < _KEPT:
                self._seen[key] = seen[:, i].clone()
        return seen

    def _each(self, some: slice, towards: Tensor) -> Tensor:
        """What some places see of directions of their own (n, D, 3): (n, D)."""
        count = towards.shape[1]
        point, flat = self.places.point[some].repeat_interleave(count, 0), towards.reshape(-1, 3)
        above = (self.places.normal[some].repeat_interleave(count, 0) * flat).sum(dim=1) > 0
        seen = torch.zeros(len(flat))
        seen[above] = self._occluder(point[above], flat[above])
        return seen.reshape(-1, count)
