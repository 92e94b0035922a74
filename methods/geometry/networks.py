"""The four networks of the geometry autoencoder: two encoders of pictures, two decoders of offsets."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from ..kit.layers import Down, activate, initialise

HALVINGS = 4
_CHANNELS = (16, 32, 48, 64)
_HIDDEN = 256
_FIRST_LOG_VARIANCE = -6.0  # at 0 a first code would be all noise, and the decoder would learn to ignore it
_LEAST_SPREAD = 0.05  # of a component, in units: what varies less is noise
OFFSET = 0.01
"""Metres of an offset per unit of a decoder's output."""


class _Perceptron(nn.Module):
    """Two layers; the last starts small, so that a training starts from the template and the joints' directions."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.first, self.last = nn.Linear(inputs, _HIDDEN), nn.Linear(_HIDDEN, outputs)
        nn.init.normal_(self.last.weight, std=0.01 / _HIDDEN**0.5)
        nn.init.zeros_(self.last.bias)

    def forward(self, x: Tensor) -> Tensor:
        return self.last(activate(self.first(x)))


class _Encoder(nn.Module):
    """A picture (B, C, S, S), halved four times and pooled to 4 x 4, and a vector (B, K) to a vector (B, O)."""

    def __init__(self, channels: int, vector: int, outputs: int) -> None:
        super().__init__()
        widths = (channels, *_CHANNELS)
        self.down = nn.ModuleList(Down(a, b) for a, b in pairwise(widths))
        initialise(self.down, activated=True)
        self.head = _Perceptron(_CHANNELS[-1] * 16 + vector, outputs)

    def encoded(self, picture: Tensor, vector: Tensor) -> Tensor:
        for layer in self.down:
            picture = activate(layer(picture))
        pooled = nn.functional.adaptive_avg_pool2d(picture, 4)
        found: Tensor = self.head(torch.cat([pooled.flatten(1), vector], dim=1))
        return found


class IdentityEncoder(_Encoder):
    """E_id: depth maps (B, 4, S, S) and joints (B, P, 3) in the neutral pose to mean and log variance (B, Z).

    Beside the perceptron the joints have a linear way to the mean, and in D_id the code one to the offsets: a hand's
    shape is mostly linear in its joints. See `principal`.
    """

    def __init__(self, points: int, code: int) -> None:
        super().__init__(4, 3 * points, 2 * code)
        self.straight = nn.Linear(3 * points, code)
        nn.init.constant_(self.head.last.bias[code:], _FIRST_LOG_VARIANCE)

    def forward(self, depth: Tensor, joints: Tensor) -> tuple[Tensor, Tensor]:
        mean, log_variance = self.encoded(depth, joints.flatten(1)).chunk(2, dim=1)
        return mean + self.straight(joints.flatten(1)), log_variance


class IdentityDecoder(nn.Module):
    """D_id: a code (B, Z) to offsets of joints (B, P, 3) and vertices (B, V, 3) in the template's space, metres."""

    def __init__(self, code: int, points: int, vertices: int) -> None:
        super().__init__()
        self._points = points
        self.layers = _Perceptron(code, 3 * (points + vertices))
        self.straight = nn.Linear(code, 3 * (points + vertices))
        nn.init.zeros_(self.straight.weight)
        nn.init.zeros_(self.straight.bias)

    def forward(self, code: Tensor) -> tuple[Tensor, Tensor]:
        offsets = OFFSET * (self.layers(code) + self.straight(code)).unflatten(1, (-1, 3))
        return offsets[:, : self._points], offsets[:, self._points :]


@torch.no_grad()
def principal(encoder: IdentityEncoder, decoder: IdentityDecoder, joints: Tensor, unit: float) -> None:
    """Start the linear ways at the principal components of the joints of many hands.

    joints (N, P, 3) are what E_id is given: offsets from the template in `unit` metres. The code then starts as their
    coordinates, of unit variance as the KL divergence wants it, and D_id's joint offsets as what it stands for.
    """
    flat = joints.flatten(1)
    middle = flat.mean(dim=0)
    _, sizes, axes = torch.linalg.svd(flat - middle, full_matrices=False)
    count = min(len(sizes), len(encoder.straight.weight))
    axes, spread = axes[:count], (sizes[:count] / len(flat) ** 0.5).clamp_min(_LEAST_SPREAD)
    nn.init.zeros_(encoder.straight.weight)
    nn.init.zeros_(encoder.straight.bias)
    encoder.straight.weight[:count] = axes / spread[:, None]
    encoder.straight.bias[:count] = -axes @ middle / spread
    decoder.straight.weight[: flat.shape[1], :count] = axes.T * spread * (unit / OFFSET)
    decoder.straight.bias[: flat.shape[1]] = middle * (unit / OFFSET)


class PoseEncoder(_Encoder):
    """E_theta: a picture (B, 3, S, S), joint positions (B, P, 3) and their directions as rotations (B, J, 3) to what
    the pose is beyond those: rotations of the joints and of the whole hand, and a translation, (B, J + 2, 3)."""

    def __init__(self, points: int, joints: int) -> None:
        super().__init__(3, 3 * (points + joints), 3 * (joints + 2))

    def forward(self, picture: Tensor, positions: Tensor, directions: Tensor) -> Tensor:
        vector = torch.cat([positions, directions], dim=1).flatten(1)
        return self.encoded(picture, vector).unflatten(1, (-1, 3))


class PoseDecoder(nn.Module):
    """D_theta: joint rotations (B, J, 3) and an identity code (B, Z) to vertex offsets (B, V, 3), metres."""

    def __init__(self, joints: int, code: int, vertices: int) -> None:
        super().__init__()
        self.layers = _Perceptron(3 * joints + code, 3 * vertices)

    def forward(self, rotations: Tensor, code: Tensor) -> Tensor:
        return OFFSET * self.layers(torch.cat([rotations.flatten(1), code], dim=1)).unflatten(1, (-1, 3))


def divergence(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL divergence of N(mean, exp(log_variance)) from the standard normal, nats, summed over the last axis."""
    return 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).sum(-1)
