"""A generator of skin textures in the manner of StyleGAN: codes become styles, styles modulate convolutions.

It is trained on procedural skins by maintainer/make_handy_generator.py and has nothing of Handy's own model, which is
given on request only (Potamias et al., CVPR 2023).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file
from scipy.ndimage import distance_transform_edt
from torch import Tensor, nn
from torch.nn.functional import conv2d, interpolate, linear

from handbench.errors import InputError

from ..kit.layers import activate

SIDES = (8, 16, 32, 64, 128)
CHANNELS = (48, 48, 32, 24, 16)
"""Sides of the maps that are synthesised one after the other, and their channels."""

SIZE = SIDES[-1]
LAYERS = 1 + len(SIDES)
"""Codes that a texture takes in w+: one for its principal components, one for each side."""

_FILE = Path(__file__).parent / "weights" / "generator.safetensors"


class Modulated(nn.Module):
    """A convolution whose inputs are scaled by a style, and whose outputs are brought back to unit variance.

    Karras et al., "Analyzing and improving the image quality of StyleGAN" (2020), Eqs. 1-3: as maps, not weights, are
    scaled, textures of different styles share one convolution; the result is the same.
    """

    def __init__(self, code: int, inputs: int, outputs: int, kernel: int, demodulate: bool = True) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.randn(outputs, inputs, kernel, kernel) / (inputs * kernel**2) ** 0.5)
        self.style = nn.Linear(code, inputs)
        nn.init.normal_(self.style.weight, std=0.3 / code**0.5)
        nn.init.ones_(self.style.bias)
        self.demodulate = demodulate

    def forward(self, x: Tensor, w: Tensor) -> Tensor:
        """Maps (B, outputs, h, w) of maps (B, inputs, h, w) and codes (B, K)."""
        style = self.style(w)
        y = conv2d(x * style[:, :, None, None], self.weight, padding=self.weight.shape[-1] // 2)
        if not self.demodulate:
            return y
        power = linear(style.square(), self.weight.square().sum(dim=(2, 3)))
        return y * (power + 1e-8).rsqrt()[:, :, None, None]


class Block(nn.Module):
    """One side of the synthesis: maps of twice the side, with detail that has its place, and what they add in colour.

    StyleGAN2 adds noise here, which is held still when a texture is fitted. Where every texel is a place of the hand
    the noise can be learned: `detail` is what lines, folds and pores there may look like.
    """

    def __init__(self, code: int, inputs: int, outputs: int, side: int) -> None:
        super().__init__()
        self.conv = Modulated(code, inputs, outputs, 3)
        self.detail = nn.Parameter(0.1 * torch.randn(outputs, side, side))
        self.bias = nn.Parameter(torch.zeros(outputs))
        self.colour = Modulated(code, outputs, 3, 1, demodulate=False)
        nn.init.zeros_(self.colour.weight)

    def forward(self, x: Tensor, w: Tensor) -> tuple[Tensor, Tensor]:
        """The next maps and their colour (B, 3, side, side)."""
        x = activate(self.conv(x, w) + self.detail + self.bias[:, None, None])
        return x, self.colour(x, w)


class Generator(nn.Module):
    """Textures (B, 3, SIZE, SIZE) in display values of codes: principal components, and what is synthesised over them.

    A code w (K,) has unit variance over the people of the training. mean (3, N) and basis (K, 3, N) are the principal
    components at the N texels that the open hand covers, of which `texels` are the flat indices; their code is w's
    first of `LAYERS` in w+.
    """

    def __init__(self, code: int, texels: Tensor) -> None:
        super().__init__()
        self.code = code
        self.texels = nn.Buffer(texels.to(torch.int32))
        self.mean = nn.Buffer(torch.zeros(3, len(texels)))
        self.basis = nn.Buffer(torch.zeros(code, 3, len(texels)))
        self.mapping = nn.Sequential(nn.Linear(code, 2 * code), nn.LeakyReLU(0.2), nn.Linear(2 * code, code))
        self.constant = nn.Parameter(torch.randn(CHANNELS[0], SIDES[0], SIDES[0]))
        inputs = (CHANNELS[0], *CHANNELS[:-1])
        self.blocks = nn.ModuleList(Block(code, i, o, side) for i, o, side in zip(inputs, CHANNELS, SIDES, strict=True))
        self._nearest = _nearest(self.texels)

    def map(self, z: Tensor) -> Tensor:
        """Codes w (B, K) of random z (B, K), distributed as the training's people are."""
        return z + self.mapping(z)

    def linear(self, w: Tensor) -> Tensor:
        """What the principal components alone draw, (B, 3, SIZE, SIZE); differentiable."""
        return self._whole(self._components(w))

    def forward(self, codes: Tensor) -> Tensor:
        """Textures of codes (B, K), or (B, LAYERS, K) of w+; texels outside the charts are as their nearest inside."""
        layers = codes[:, None].expand(-1, LAYERS, -1) if codes.ndim == 2 else codes
        x = self.constant.expand(len(layers), -1, -1, -1)
        colour = torch.zeros(())
        for number, block in enumerate(self.blocks, start=1):
            if number > 1:
                x = interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
                colour = interpolate(colour, scale_factor=2, mode="bilinear", align_corners=False)
            x, more = block(x, layers[:, number])
            colour = colour + more
        seen = colour.flatten(2).index_select(2, self.texels)
        return self._whole(self._components(layers[:, 0]) + seen)

    def _components(self, w: Tensor) -> Tensor:
        return self.mean + linear(w, self.basis.flatten(1).T).unflatten(1, self.mean.shape)

    def _whole(self, values: Tensor) -> Tensor:
        """Whole textures of values (B, 3, N) at the covered texels."""
        return values.index_select(2, self._nearest).unflatten(2, (SIZE, SIZE))


def _nearest(texels: Tensor) -> Tensor:
    """For every texel the number (SIZE * SIZE,) of the nearest covered one."""
    number = np.zeros(SIZE * SIZE, dtype=np.int64)
    number[texels.numpy()] = np.arange(len(texels))
    away = np.ones((SIZE, SIZE), dtype=bool)
    away.ravel()[texels.numpy()] = False
    row, column = distance_transform_edt(away, return_distances=False, return_indices=True)
    return torch.from_numpy(number[(row * SIZE + column).ravel()])


def built(state: Mapping[str, Tensor]) -> Generator:
    """The generator with the tensors of a weight file, in float32, fixed. Raises `KeyError` or `RuntimeError`."""
    made = Generator(state["basis"].shape[0], state["texels"])
    made.load_state_dict({name: v.float() if v.is_floating_point() else v for name, v in state.items()})
    return made.requires_grad_(False).eval()


@cache
def shipped() -> Generator:
    """The generator in the package (one shared object); `InputError` if its file is missing or damaged."""
    try:
        return built(load_file(_FILE))
    except Exception as error:  # safetensors raises its own types for a damaged file
        raise InputError(f"weights {_FILE} cannot be read ({error}); install handbench again") from error
