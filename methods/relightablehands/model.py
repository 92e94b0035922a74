"""RelightableHands on a mesh: what a hand answers to each light on its own (URHand supp. Sec. 5.1)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from handbench.render.uv.atlas import Atlas
from handbench.render.uv.posed import PosedSurface
from handbench.render.uv.surface import unit
from handbench.scene import Array

from ..kit.layers import channels_last
from .config import Bias, RelightableHandsConfig
from .frames import tangent_frames
from .networks import TextureDecoder

NEAREST = 1e-3
"""Metres within which a near light grows no brighter: it would be infinitely so on the surface."""

SCALE, OFFSET = 25.0, 100.0  # lambda_s and lambda_b of Eq. 7, of images of 0..255


def coloured(texture: Tensor, shadow: Tensor, bias: Bias) -> tuple[Tensor, Tensor]:
    """The colour C of Eq. 7 on a scale of 0..255, and what goes into its ReLU, of raw maps (…, 3, N), (…, 1, N).

    bias "outside": C = σ(S) (ReLU(25 T) + 100), as the supplement prints it; "inside": C = σ(S) ReLU(25 T + 100),
    as in the released code.
    """
    cut = SCALE * texture if bias == "outside" else SCALE * texture + OFFSET
    return shadow.sigmoid() * (cut.relu() + (OFFSET if bias == "outside" else 0.0)), cut


@dataclass(frozen=True)
class ViewedTexels:
    """A pose in a camera: the texels' positions (3, N) and frames (3, 3, N), the view direction in these (3, N), joint
    rotations (J, 3)."""

    position: Tensor
    frames: Tensor
    view: Tensor
    joints: Tensor
    atlas: Atlas

    @staticmethod
    def of(posed: PosedSurface, centre: Array, joints: Tensor) -> ViewedTexels:
        frames = tangent_frames(posed)
        device = posed.position.device
        view = unit(torch.as_tensor(centre, dtype=torch.float32, device=device)[:, None] - posed.position)
        return ViewedTexels(posed.position, frames, (frames * view).sum(dim=1), joints.to(device), posed.atlas)


class RelightableHandsModel(nn.Module):
    """The texture decoder of one identity, and how bright its pictures are.

    `exposure` is the radiance under a light of unit irradiance that counts as 255 in Eq. 7. Everything that comes in
    or goes out is float32 on the `device` of the parameters.
    """

    exposure: Tensor

    def __init__(self, config: RelightableHandsConfig, joints: int, exposure: float) -> None:
        super().__init__()
        self.config = config
        self.decoder = TextureDecoder(3 * joints, config.texture)
        self.register_buffer("exposure", torch.tensor(exposure))
        channels_last(self)

    @property
    def device(self) -> torch.device:
        """Where the parameters are."""
        return self.exposure.device

    def responses(
        self, seen: ViewedTexels, directions: Array, visible: Tensor, positions: Array | None = None
    ) -> tuple[Tensor, Tensor]:
        """Radiance (L, 3, N) of the texels under each of L lights of unit power, and what goes into the ReLU of Eq. 7.

        directions (D, 3) are unit vectors to the distant lights, of unit irradiance; positions (P, 3) those of near
        lights, of unit intensity, which falls off with the square of the distance; L = D + P. visible (L, N) says
        which reach the texels. Directions go in in the texels' own frames: the released code turns them into those of
        its primitives, which lie on the surface alike.
        """
        device = seen.position.device
        distant = torch.tensor(directions, dtype=torch.float32, device=device)
        light = torch.einsum("ijn,lj->lin", seen.frames, distant)
        falloff = None
        if positions is not None and len(positions):
            towards = torch.tensor(positions, dtype=torch.float32, device=device)[:, :, None] - seen.position
            distance = towards.norm(dim=1, keepdim=True).clamp_min(NEAREST)
            light = torch.cat([light, torch.einsum("ijn,ljn->lin", seen.frames, towards / distance)])
            falloff = torch.cat([distance.new_ones(len(directions), 1, distance.shape[-1]), distance**-2])
        flat = torch.cat([seen.view.expand_as(light), light, visible[:, None].float()], dim=1)
        inputs = seen.atlas.dilate(seen.atlas.scatter(flat))
        maps = self.decoder(inputs.contiguous(memory_format=torch.channels_last), seen.joints.reshape(1, -1))
        texture, shadow = (seen.atlas.gather(raw) for raw in maps)
        colour, cut = coloured(texture, shadow, self.config.bias)
        radiance = colour * (self.exposure / 255.0)
        return radiance if falloff is None else radiance * falloff, cut


def lit(responses: Tensor, power: Array) -> Tensor:
    """Radiance (3, N) under lights of irradiance or intensity (L, 3), from what the hand answers to each (L, 3, N)."""
    return torch.einsum("lcn,lc->cn", responses, torch.tensor(power, dtype=responses.dtype, device=responses.device))
