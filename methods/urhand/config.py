"""The settings of URHand and its named presets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from handbench.errors import InputError, unknown_name
from handbench.light.spread import ENVIRONMENT_ERROR

from ..kit.engine import Budget
from ..kit.views import Shadows
from .networks import HALVINGS

_BYTE = 255.0  # the papers weigh losses of images of 0..255, ours are 0..1


@dataclass(frozen=True)
class UrhandConfig:
    """Everything that can change a result.

    Training
    texture         side of all UV maps in texels, a multiple of 64 (six halvings)
    steps, batch    training steps, and pictures a step
    rate            Adam's learning rate after `warmup` steps and at the last step, decayed exponentially
    warmup          steps over which the rate rises from zero: seven modulated layers multiply a first wrong step
    lights          how many pictures of a view a step may combine, each of a single light or of a group; each count
                    is as likely
    bfloat16        run the networks' convolutions in bfloat16 (shading never is)

    Losses (Eq. 7)
    perceptual      weight of the perceptual loss beside the L1 loss of 1, on the final and the physical picture
    physical        weight of the image loss of the physical branch's picture
    adversarial     weight of the adversarial loss (Eq. 8); 0 trains no discriminator
    light_aware     whether the discriminator is conditioned on the Phong shading of the light
    sparsity        weight of the L1 regularisation of the encoder's features (Eq. 9): the mean over each map is
                    taken, so texture sizes agree
    consistency     weight of the linear consistency loss (supp. Eq. 8), which is added every `consistency_every` steps
    focus           weigh absolute differences by their exponential, as the released code does

    Lighting
    network         "linear": no activation and no bias (Sec. 4.3); "non-linear": leaky ReLU after every layer
    encoder         "features": convolutions of shading features; "environment": one bias-free layer from a 16 x 32
                    environment map (supp. Sec. 5.2, MLP-based)
    shading         "brdf": Eqs. 1-6; "phong"; "released": the specular feature of the released code
    specular, refiner, neural    whether there are a specular feature, a refined normal, a neural branch
    shadows         "hard" (rays), "soft" (shadow maps, as the released code) or "none"
    exposure        divide features by the sum of the lights' power before the network and multiply after; when
                    drawing also by the visible share of it (released code; breaks additivity)
    environment     rows and columns to which environments are reduced
    environment_error   how far lights of an environment may be moved when drawing, see `handbench.light.spread`;
                    0: each texel is a light

    Ranges
    displacement    greatest displacement in metres (URHand Sec. 4.2 says 3 mm, through a sigmoid)
    roughness       range of the roughness map
    bias_scale      sigma_T of Eq. 6: 64 on a 0..255 scale
    """

    texture: int = 128
    steps: int = 2000
    batch: int = 1
    rate: tuple[float, float] = (5e-4, 5e-5)
    warmup: int = 300
    lights: tuple[int, ...] = (1, 2, 3, 5)
    bfloat16: bool = False
    perceptual: float = 1.0 / _BYTE
    physical: float = 1.0
    adversarial: float = 0.01 / _BYTE
    light_aware: bool = True
    sparsity: float = 0.01 / _BYTE
    consistency: float = 0.0
    consistency_every: int = 4
    focus: bool = False
    network: Literal["linear", "non-linear"] = "linear"
    encoder: Literal["features", "environment"] = "features"
    shading: Literal["brdf", "phong", "released"] = "brdf"
    specular: bool = True
    refiner: bool = True
    neural: bool = True
    shadows: Shadows = "hard"
    exposure: bool = False
    environment: tuple[int, int] = (16, 32)
    environment_error: float = ENVIRONMENT_ERROR
    displacement: float = 3e-3
    roughness: tuple[float, float] = (0.1, 0.9)
    bias_scale: float = 64.0 / _BYTE

    def __post_init__(self) -> None:
        if self.texture < 1 or self.texture % 2**HALVINGS:
            raise InputError(
                f"urhand: texture {self.texture} is no multiple of {2**HALVINGS}; its networks halve it six times"
            )

    @property
    def budget(self) -> Budget:
        # a short memory of squared gradients: one bad step of the multiplied layers is soon damped
        return Budget(self.steps, self.batch, self.rate, self.warmup, betas=(0.9, 0.99))

    @property
    def linear(self) -> bool:
        """Whether the answer is linear in light by construction."""
        return self.network == "linear" and not self.exposure

    @property
    def near_lights(self) -> bool:
        """Whether lights at finite distance can be drawn."""
        return self.encoder == "features" and self.shading != "released" and not self.exposure


PRESETS = {
    "smoke": UrhandConfig(texture=64, steps=30, warmup=10),
    "ablation": UrhandConfig(steps=600, warmup=150),
    "quick": UrhandConfig(),
    "standard": UrhandConfig(texture=256, steps=20_000, rate=(5e-4, 3e-5)),
    "paper": UrhandConfig(
        texture=1024, steps=2_000_000, batch=24, rate=(1e-4, 3e-5), lights=(5,), environment_error=0.0
    ),
    # what the authors' released training code does differently from their paper and its supplement
    "released": UrhandConfig(
        texture=1024,
        steps=400_000,
        rate=(1e-4, 1e-4),
        warmup=0,
        lights=(5,),
        adversarial=0.0,
        focus=True,
        shading="released",
        shadows="soft",
        exposure=True,
        environment_error=0.0,
        roughness=(0.3, 0.8),
    ),
}


def configuration(preset: str) -> UrhandConfig:
    """The settings of a preset; `InputError` with the closest names for an unknown one."""
    if preset not in PRESETS:
        raise unknown_name("preset of urhand", preset, PRESETS)
    return PRESETS[preset]
