"""PALM-Net's three fields in canonical space: geometry f_g, radiance f_rf, material f_m (its Secs. 2.2 and 2.3)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple, cast

import torch
from torch import Tensor, nn

from .encoding import Encoding
from .reflectance import Material

SHARPNESS = 100.0
"""Of the softplus in f_g: nearly a ReLU, but with a second derivative for the eikonal term."""

_ALBEDO, _ROUGHNESS = (0.03, 0.77), (0.09, 0.9)  # least value and range (released code)


class Geometry(NamedTuple):
    """Of N places: signed distance (N,) in metres, positive outside; features (N, F) that go on to the other fields;
    gradient (N, 3) of the distance by the place, or None."""

    sdf: Tensor
    feature: Tensor
    gradient: Tensor | None


class Conditioned(nn.Module):
    """Fully connected layers whose first one also sees a code (C,), the same for all N places: (N, I) to (N, O)."""

    def __init__(self, inputs: int, code: int, hidden: Sequence[int], outputs: int, activation: nn.Module) -> None:
        super().__init__()
        sizes = [inputs, *hidden, outputs]
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))
        self.code = nn.Linear(code, sizes[1], bias=False)
        self.activation = activation

    def forward(self, x: Tensor, code: Tensor) -> Tensor:
        first, *rest = self.layers
        x = first(x) + self.code(code)
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

    def __init__(self, encoding: Encoding, features: int, code: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.encoding = encoding
        self.network = Conditioned(encoding.size + features + 16 + 3, code, hidden, 3, nn.ReLU())

    def forward(self, x: Tensor, feature: Tensor, reflected: Tensor, normal: Tensor, code: Tensor) -> Tensor:
        inputs = [self.encoding(x), feature, real_harmonics(reflected), normal]
        return torch.sigmoid(self.network(torch.cat(inputs, dim=1), code))


class LipschitzLinear(nn.Linear):
    """A layer whose rows are scaled so that no output changes faster than softplus(bound) (Liu et al. 2022)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(inputs, outputs)
        self.bound = nn.Parameter(2.0 * self.weight.detach().abs().sum(dim=1).max())

    def forward(self, x: Tensor) -> Tensor:
        scale = (nn.functional.softplus(self.bound) / self.weight.abs().sum(dim=1)).clamp_max(1.0)
        return nn.functional.linear(x, self.weight * scale[:, None], self.bias)


class MaterialField(nn.Module):
    """f_m: place, features of f_g, pose and code ψ to albedo, roughness and metallic.

    Looks places up in the tables of f_rf, as the released code does. With `lipschitz` its layers are bounded; then
    every layer sees everything through bounded rows, the code too.
    """

    def __init__(self, places: int, features: int, code: int, hidden: Sequence[int], lipschitz: bool) -> None:
        super().__init__()
        sizes = [places + features + code, *hidden, 5]
        kind = LipschitzLinear if lipschitz else nn.Linear
        self.layers = nn.ModuleList(kind(a, b) for a, b in pairwise(sizes))

    def forward(self, place: Tensor, feature: Tensor, code: Tensor) -> Material:
        x = torch.cat([place, feature, code.expand(len(place), -1)], dim=1)
        for layer in self.layers[:-1]:
            x = torch.relu(layer(x))
        values = torch.sigmoid(self.layers[-1](x))
        albedo = _ALBEDO[0] + _ALBEDO[1] * values[:, :3]
        return Material(albedo, _ROUGHNESS[0] + _ROUGHNESS[1] * values[:, 3], values[:, 4])


def real_harmonics(directions: Tensor) -> Tensor:
    """The 16 real spherical harmonics of degree 0 to 3 ("degree 4" in the literature of radiance fields), (N, 16)."""
    x, y, z = directions.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    one = torch.ones_like(x)
    return torch.stack(
        [
            0.28209479 * one,
            -0.48860251 * y,
            0.48860251 * z,
            -0.48860251 * x,
            1.09254843 * x * y,
            -1.09254843 * y * z,
            0.31539157 * (3.0 * zz - 1.0),
            -1.09254843 * x * z,
            0.54627422 * (xx - yy),
            0.59004359 * y * (-3.0 * xx + yy),
            2.89061144 * x * y * z,
            0.45704580 * y * (1.0 - 5.0 * zz),
            0.37317633 * z * (5.0 * zz - 3.0),
            0.45704580 * x * (1.0 - 5.0 * zz),
            1.44530572 * z * (xx - yy),
            0.59004359 * x * (-xx + 3.0 * yy),
        ],
        dim=1,
    )
