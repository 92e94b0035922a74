"""The settings of the geometry autoencoder and its named presets."""

from __future__ import annotations

from dataclasses import dataclass

from handbench.errors import InputError, unknown_name

from ..kit.engine import Budget
from .networks import HALVINGS


@dataclass(frozen=True)
class GeometryConfig:
    """Everything that can change a result. Losses are of millimetres (the paper names no unit).

    Inputs
    image, depth    sides of the pose encoder's picture and of the identity encoder's depth maps, in pixels
    code            numbers in an identity code
    points          scan points that a training step looks at
    scale           a step enlarges the world by a random factor of this range: hand, scan and cameras together, which
                    leaves every picture as it is, so more sizes of hands are trained on exactly
    warp            strength of the smooth random deformations of neutral hands (`neutral.warped`) that half of the
                    steps train the identity on: the paper has 93 identities, small captures have four

    Training
    steps, batch    training steps, and frames a step
    rate            Adam's learning rate after `warmup` steps and at the last step

    Losses (supp. Sec. 4.1)
    joint, scan, divergence    weights of the L1 distance of joints, of the point-to-point L1 distance from the scan,
                               and of the KL divergence of the identity code: 1, 10 and 0.001 in the paper
    smooth          regulariser: squared Laplacian of identity and pose correctives (Moon et al., DeepHandMesh)
    small           regulariser: squared size of pose correctives, which keeps identity out of them
    steady          regulariser: squared size, in radians, of what the pose encoder adds to the joints' directions
    """

    image: int = 128
    depth: int = 64
    code: int = 32
    points: int = 1500
    scale: tuple[float, float] = (0.88, 1.14)
    warp: float = 0.08
    steps: int = 2000
    batch: int = 1
    rate: tuple[float, float] = (2e-4, 2e-5)
    warmup: int = 50
    joint: float = 1.0
    scan: float = 10.0
    divergence: float = 1e-3
    smooth: float = 10.0
    small: float = 0.1
    steady: float = 10.0

    def __post_init__(self) -> None:
        for name, value in (("image", self.image), ("depth", self.depth)):
            if value < 1 or value % 2**HALVINGS:
                raise InputError(f"geometry: {name} {value} is no multiple of {2**HALVINGS}; give one, such as 64")
        for name, value in (("code", self.code), ("points", self.points)):
            if value < 1:
                raise InputError(f"geometry: {name} is {value}; give at least 1")
        if self.warp < 0.0:
            raise InputError(f"geometry: warp is {self.warp}; give 0 for none, or a small positive number")
        if not 0.0 < self.scale[0] <= self.scale[1]:
            raise InputError(f"geometry: scale {self.scale} must be a range of positive factors")

    @property
    def budget(self) -> Budget:
        return Budget(self.steps, self.batch, self.rate, self.warmup)


PRESETS = {
    "smoke": GeometryConfig(image=64, depth=32, points=500, steps=30, warmup=5),
    "quick": GeometryConfig(),
    "standard": GeometryConfig(image=256, points=4000, steps=20_000),
    # the paper gives no sizes, steps or batch for this network
    "paper": GeometryConfig(image=256, depth=128, points=10_000, steps=200_000, batch=8, rate=(1e-4, 1e-5)),
}


def configuration(preset: str) -> GeometryConfig:
    """The settings of a preset; `InputError` with the closest names for an unknown one."""
    if preset not in PRESETS:
        raise unknown_name("preset of geometry", preset, PRESETS)
    return PRESETS[preset]
