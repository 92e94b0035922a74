"""The settings of URHand and its named presets."""

from __future__ import annotations

from dataclasses import dataclass

from handbench.errors import InputError, unknown_name

from .networks import HALVINGS


@dataclass(frozen=True)
class Config:
    """Everything that can change a result.

    texture         side of all UV maps in texels, a multiple of 64 (six halvings)
    steps           training steps, one picture each (`batch` pictures a step)
    rate            Adam's learning rate after `warmup` steps and at the last step, decayed exponentially
    warmup          steps over which the rate rises from zero: seven modulated layers multiply a first wrong step
    lights          how many stage lights a step may combine; each count is as likely
    displacement    greatest displacement in metres (URHand Sec. 4.2 says 3 mm, through a sigmoid)
    roughness       range of the roughness map
    image, physical weights of the image loss on the final and on the physical branch's picture
    sparsity        weight of the L1 regularisation of the encoder's features (Eq. 9): the paper's 0.01 stands beside
                    images of 0..255, ours are 0..1; the mean over each map is taken, so texture sizes agree
    bias_scale      sigma_T of Eq. 6: 64 on a 0..255 scale
    environment     rows and columns to which environments are reduced
    """

    texture: int = 128
    steps: int = 2400
    batch: int = 1
    rate: tuple[float, float] = (5e-4, 5e-5)
    warmup: int = 300
    lights: tuple[int, ...] = (1, 2, 3, 5)
    displacement: float = 3e-3
    roughness: tuple[float, float] = (0.1, 0.9)
    image: float = 1.0
    physical: float = 1.0
    sparsity: float = 0.01 / 255.0
    bias_scale: float = 64.0 / 255.0
    environment: tuple[int, int] = (16, 32)

    def __post_init__(self) -> None:
        if self.texture < 1 or self.texture % 2**HALVINGS:
            raise InputError(
                f"urhand: texture {self.texture} is no multiple of {2**HALVINGS}; its networks halve it six times"
            )


PRESETS = {
    "smoke": Config(texture=64, steps=30, warmup=10),
    "quick": Config(),
    "standard": Config(texture=256, steps=20_000, rate=(5e-4, 3e-5)),
    "paper": Config(texture=1024, steps=2_000_000, batch=24, rate=(1e-4, 3e-5), lights=(5,)),
}


def configuration(preset: str) -> Config:
    """The settings of a preset; `InputError` with the closest names for an unknown one."""
    if preset not in PRESETS:
        raise unknown_name("preset of urhand", preset, PRESETS)
    return PRESETS[preset]
