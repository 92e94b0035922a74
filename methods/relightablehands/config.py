"""The settings of RelightableHands and its named presets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from handbench.errors import InputError, unknown_name

from ..kit.engine import Budget
from .networks import HALVINGS

Bias: TypeAlias = Literal["outside", "inside"]

_L2 = 0.0016 * 255.0**2  # the released weight of the L2 loss, for images of 0..1


@dataclass(frozen=True)
class RelightableHandsConfig:
    """Everything that can change a result.

    texture             side of all UV maps in texels, a multiple of 32 (five halvings)
    bias                Eq. 7: "outside" the ReLU, as URHand's supplement prints it, or "inside", as the released code
    steps, batch        training steps of one subject, and pictures a step
    rate                Adam's learning rate after `warmup` steps and at the last step, decayed exponentially; the
                        released code has AdamW at 5e-4
    warmup              steps over which the rate rises from zero
    lights              how many pictures of a view a step may combine, each of a single light or of a group; each count
                        is as likely, each light costs a pass
    environment_lights  the greatest number of distant lights that stand for an environment: each costs a pass

    Losses: 1 times L2, and these. The released weights on 0..255 (L2 .0016, VGG 1, negative colour .01) are all
    divided by .0016 · 255², so that only their shares count.
    perceptual          weight of the perceptual loss, in the place of VGG's
    negative            weight of the mean square of what the ReLU of Eq. 7 cuts off
    """

    texture: int = 128
    bias: Bias = "outside"
    steps: int = 1200
    batch: int = 1
    rate: tuple[float, float] = (2e-3, 2e-4)
    warmup: int = 100
    lights: tuple[int, ...] = (1, 2, 3)
    environment_lights: int = 32
    perceptual: float = 1.0 / _L2
    negative: float = 0.01 * 255.0**2 / _L2

    def __post_init__(self) -> None:
        if self.texture < 1 or self.texture % 2**HALVINGS:
            raise InputError(
                f"relightablehands: texture {self.texture} is no multiple of {2**HALVINGS}; "
                f"its network halves it {HALVINGS} times"
            )
        if self.environment_lights < 1:
            raise InputError(
                f"relightablehands: environment_lights is {self.environment_lights}; an environment needs at least 1"
            )

    @property
    def budget(self) -> Budget:
        return Budget(self.steps, self.batch, self.rate, self.warmup)


PRESETS = {
    "smoke": RelightableHandsConfig(texture=64, steps=20, warmup=5, environment_lights=8),
    "ablation": RelightableHandsConfig(steps=600),
    "quick": RelightableHandsConfig(),
    "standard": RelightableHandsConfig(texture=256, steps=20_000, rate=(1e-3, 1e-4), environment_lights=128),
    "paper": RelightableHandsConfig(
        texture=1024, steps=400_000, rate=(5e-4, 5e-4), warmup=0, lights=(5,), environment_lights=512
    ),
}


def configuration(preset: str) -> RelightableHandsConfig:
    """The settings of a preset; `InputError` with the closest names for an unknown one."""
    if preset not in PRESETS:
        raise unknown_name("preset of relightablehands", preset, PRESETS)
    return PRESETS[preset]
