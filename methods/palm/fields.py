"""PALM-Net's three fields in canonical space: geometry f_g, radiance f_rf, material f_m (its Secs. 2.2 and 2.3)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from handbench.light.harmonics import harmonics_of

from .encoding import Encoding
from .reflectance import Material

SHARPNESS = 100.0
"""Of the softplus in f_g: nearly a ReLU, but with a second derivative for the eikonal term."""

_ALBEDO, _ROUGHNESS = (0.03, 0.77), (0.09, 0.9)  # least value and range (released code)
_MODULATED = 0.1  # how far a code of unit entries moves a weight at first, standard deviation
_DEGREE = 3  # of the harmonics of reflected directions: 16, "degree 4" in the literature of radiance fields


class Modulation(nn.Module):
    """What a code (C,) adds to the weights (O, I) of a layer: with it a person has a mixture of a layer's inputs of
    their own. As the code is the same for all places, that costs next to nothing."""

    def __init__(self, code: int, inputs: int, outputs: int) -> None:
        super().__init__()
        self.size = (outputs, inputs)
        self.weights = nn.Linear(code, inputs * outputs, bias=False)
        nn.init.normal_(self.weights.weight, std=_MODULATED / code**0.5)

    def forward(self, code: Tensor) -> Tensor:
        change: Tensor = self.weights(code).view(self.size)
        return change


class Geometry(NamedTuple):
    """Of N places: signed distance (N,) in metres, positive outside; features (N, F) that go on to the other fields;
    gradient (N, 3) of the distance by the place, or None."""

    sdf: Tensor
    feature: Tensor
    gradient: Tensor | None


class Conditioned(nn.Module):
    """Fully connected layers whose first one also sees a code (C,), the same for all N places: (N, I) to (N, O).

    The code moves the first layer's biases, and its weights, too, if there is a `Modulation`.
    """

    def __init__(
        self,
        inputs: int,
        code: int,
        hidden: Sequence[int],
        outputs: int,
        activation: nn.Module,
        modulated: bool = False,
    ) -> None:
        super().__init__()
        sizes = [inputs, *hidden, outputs]
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))
        self.code = nn.Linear(code, sizes[1], bias=False)
        self.modulation = Modulation(code, inputs, sizes[1]) if modulated else None
        self.activation = activation

    def forward(self, x: Tensor, code: Tensor) -> Tensor:
        first, *rest = self.layers
        assert isinstance(first, nn.Linear)
        weight = first.weight if self.modulation is None else first.weight + self.modulation(code)
        x = nn.functional.linear(x, weight, first.bias) + self.code(code)
        for layer in rest:
            x = layer(self.activation(x))
        return x


class GeometryField(nn.Module):
    """f_g: place, pose, shape and code φ to signed distance, in units of half the box, and F features.

    Begins as a sphere of half the box's size (Atzmon and Lipman 2020): tables begin near zero, so that only the
    coordinates count. All outputs are features, the distance too (released code).
    """

    def __init__(self, encoding: Encoding, code: int, hidden: Sequence[int], features: int) -> None:
        super().__init__()
        self.encoding = encoding
        self.network = Conditioned(encoding.size + 3, code, hidden, 1 + features, nn.Softplus(SHARPNESS))
        with torch.no_grad():
            first, last = (cast(nn.Linear, self.network.layers[i]) for i in (0, -1))
            first.weight[:, : encoding.size] = 0.0
            nn.init.normal_(first.weight[:, encoding.size :], std=(2.0 / hidden[0]) ** 0.5)
            nn.init.zeros_(first.bias)
            nn.init.zeros_(self.network.code.weight)
            nn.init.normal_(last.weight[:1], mean=(torch.pi / hidden[-1]) ** 0.5, std=1e-4)
            nn.init.constant_(last.bias[:1], -0.5)

    def forward(self, x: Tensor, aspect: Tensor, code: Tensor) -> tuple[Tensor, Tensor]:
        """Distance (N,) and outputs (N, 1 + F) at places (N, 3) in [-1, 1] of a box of sides `aspect` (3,)."""
        outputs = self.network(torch.cat([self.encoding(x), x * aspect], dim=1), code)
        return outputs[:, 0], outputs

    def with_gradient(self, x: Tensor, aspect: Tensor, code: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The same, and the gradient (N, 3) of the distance by x * aspect.

        The network's part of the chain rule is autograd's, with its graph, so that losses of the gradient can be
        differentiated (a double backward); the encoding's part is its slopes.
        """
        graph = torch.is_grad_enabled()
        with torch.enable_grad():
            features, slopes = self.encoding.with_slopes(x)
            if not graph:
                features = features.detach()
            if not features.requires_grad:
                features.requires_grad_(True)
            coordinates = (x * aspect).detach().requires_grad_(True)
            outputs = self.network(torch.cat([features, coordinates], dim=1), code)
            by_features, gradient = torch.autograd.grad(
                outputs[:, 0].sum(), (features, coordinates), create_graph=graph
            )
        gradient = gradient + (slopes @ by_features[..., None]).squeeze(2) / aspect
        if not graph:  # what autograd needed in between is no graph of the caller's
            outputs, gradient = outputs.detach(), gradient.detach()
        return outputs[:, 0], outputs, gradient


class RadianceField(nn.Module):
    """f_rf: place, features of f_g, reflected direction, normal, pose and code ψ to linear radiance in [0, 1]."""

    def __init__(self, encoding: Encoding, features: int, code: int, hidden: Sequence[int], modulated: bool) -> None:
        super().__init__()
        self.encoding = encoding
        inputs = encoding.size + features + (_DEGREE + 1) ** 2 + 3
        self.network = Conditioned(inputs, code, hidden, 3, nn.ReLU(), modulated)

    def forward(self, x: Tensor, feature: Tensor, reflected: Tensor, normal: Tensor, code: Tensor) -> Tensor:
        x_axis, y_axis, z_axis = reflected.unbind(1)
        directions = torch.stack(harmonics_of(x_axis, y_axis, z_axis, _DEGREE), dim=1)
        inputs = [self.encoding(x), feature, directions, normal]
        return torch.sigmoid(self.network(torch.cat(inputs, dim=1), code))


class LipschitzLinear(nn.Linear):
    """A layer whose rows are scaled so that no output changes faster than softplus(bound) (Liu et al. 2022)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(inputs, outputs)
        self.bound = nn.Parameter(2.0 * self.weight.detach().abs().sum(dim=1).max())

    def limited(self, weight: Tensor) -> Tensor:
        """Weights (O, I) with their rows scaled."""
        scale = (nn.functional.softplus(self.bound) / weight.abs().sum(dim=1)).clamp_max(1.0)
        return weight * scale[:, None]

    def forward(self, x: Tensor) -> Tensor:
        return nn.functional.linear(x, self.limited(self.weight), self.bias)


class MaterialField(nn.Module):
    """f_m: place, features of f_g, pose and code ψ to albedo, roughness and metallic.

    Looks places up in the tables of f_rf, as the released code does. With `lipschitz` its layers are bounded; then
    every layer sees everything through bounded rows, the code too. Where the code moves weights, rows are bounded for
    each code.
    """

    def __init__(
        self, places: int, features: int, code: int, hidden: Sequence[int], lipschitz: bool, modulated: bool
    ) -> None:
        super().__init__()
        sizes = [places + features + code, *hidden, 5]
        kind = LipschitzLinear if lipschitz else nn.Linear
        self.layers = nn.ModuleList(kind(a, b) for a, b in pairwise(sizes))
        self.modulation = Modulation(code, sizes[0], sizes[1]) if modulated else None

    def forward(self, place: Tensor, feature: Tensor, code: Tensor) -> Material:
        x = torch.cat([place, feature, code.expand(len(place), -1)], dim=1)
        x = self._first(x, code)
        for layer in self.layers[1:]:
            x = layer(torch.relu(x))
        values = torch.sigmoid(x)
        albedo = _ALBEDO[0] + _ALBEDO[1] * values[:, :3]
        return Material(albedo, _ROUGHNESS[0] + _ROUGHNESS[1] * values[:, 3], values[:, 4])

    def _first(self, x: Tensor, code: Tensor) -> Tensor:
        first = cast(nn.Linear, self.layers[0])
        if self.modulation is None:
            return cast(Tensor, first(x))
        weight = first.weight + self.modulation(code)
        if isinstance(first, LipschitzLinear):
            weight = first.limited(weight)
        return nn.functional.linear(x, weight, first.bias)
