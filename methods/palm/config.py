"""The settings of PALM-Net's prior and its named presets."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from handbench.errors import InputError
from handbench.hand.canonical import AllBones, NearestBones, Starts
from handbench.render.volume import Marching

from ..kit.engine import Budget


@dataclass(frozen=True)
class PalmConfig:
    """Everything that can change a prior.

    Canonical space
    canonical       "shared": the neutral hand at rest for everybody, what a person's shape changes is part of the
                    deformation; "subject": the person's own hand at rest (seed and code)
    spacing         metres between nodes of the field of skinning weights (code: 5.2 mm)
    bones           from how many nearest bones roots are searched; 0 for all (seed and code)
    normals         "jacobian": posed normals by the inverse transpose; "rotation": by the blended rotation (code)

    Fields
    encoding        "triplane" or "hash" (seed and code)
    grids, plane, plane_features        of the former, see `TriPlane`
    levels, level_features, table, base, finest     of the latter, see `HashGrid`
    geometry, appearance, material      widths of the hidden layers of f_g, f_rf, f_m
    features        of f_g for the other fields, beside the distance
    skin_features   of each table of the encoding that f_rf and f_m share; None: as many as f_g's have (seed and code)
    modulated       whether codes move the weights of the first layers of f_rf and f_m too, or are inputs alone (seed
                    and code): networks of minutes else draw one skin for all people, lighter or darker
    phi, psi        sizes of the codes of geometry and appearance
    pose, shape     sizes of what the joints' angles and the shape are made into for the fields; the released code gives
                    them the pose and not the shape
    lipschitz       whether f_m is bounded
    beta            metres, softness of the surface that training starts from (code: 0.3, IntrinsicAvatar's for bodies)

    Rays
    step, samples, softness     see `Marching`; reach: metres around the hand model in which the surface may be
    refine          further intervals a ray that the fields' own surface chooses (code: 16 + 16 after 1,000 steps)
    least_weight    samples of less weight are left out of colours when drawing

    Training
    geometry_steps  steps on scans alone; a person's mesh is used where there is no scan (code: meshes of MANO)
    steps           steps on pictures, one pose each
    normals_from, light_from    share of the steps from which on normals and curvature, and physical colours, count
    rays, patch     rays of a step beside one patch of so many pixels along a side
    scan_points     points of the scan a step; 0: geometry from pictures alone, as the seed
    scattered       directions a ray in physical colours (code: 512), each at a place of its own; or all of them at each
                    of `places`, which with few of them leaves less noise (seed and code: None)
    gaussians       spherical Gaussians of the studio's light (seed: 8, code: 64)
    register        fit the hand model to scans before training: tracked poses are off by some millimetres
    rate, warmup    of Adam, see `Budget`. The seed decays exponentially, the code does not; the code trains geometry
                    and codes at half the rate, here there is one

    Weights of losses, beside 1 for the L1 loss of f_rf's colours
    physical, mask, normal, eikonal, curvature, latent, perceptual      as in the seed. `normal` falls linearly to a
                    fifth, as in the code; the seed lets that of the mask fall
    scan, scan_normal       of a scan's distances (per 5 mm) and normals
    """

    canonical: Literal["shared", "subject"] = "shared"
    spacing: float = 4e-3
    bones: int = 2
    normals: Literal["jacobian", "rotation"] = "jacobian"

    encoding: Literal["triplane", "hash"] = "triplane"
    grids: tuple[int, ...] = (16, 32, 64)
    plane: int = 256
    plane_features: int = 4
    levels: int = 8
    level_features: int = 2
    table: int = 14
    base: int = 16
    finest: float = 512.0
    geometry: tuple[int, ...] = (64,)
    appearance: tuple[int, ...] = (64, 64)
    material: tuple[int, ...] = (64, 64)
    features: int = 12
    skin_features: int | None = 8
    modulated: bool = True
    phi: int = 8
    psi: int = 24
    pose: int = 16
    shape: int = 0
    lipschitz: bool = True
    beta: float = 1.5e-3

    step: float = 2e-3
    samples: int = 8
    softness: float = 1.5e-3
    reach: float = 8e-3
    refine: int = 0
    least_weight: float = 1e-3

    geometry_steps: int = 500
    steps: int = 2600
    normals_from: float = 0.0
    light_from: float = 0.4
    rays: int = 384
    patch: int = 24
    scan_points: int = 512
    scattered: int = 96
    places: int | None = 1
    gaussians: int = 16
    register: bool = True
    rate: tuple[float, float] = (5e-3, 5e-4)
    warmup: int = 50

    physical: float = 0.2
    mask: float = 0.1
    normal: float = 0.1
    eikonal: float = 0.1
    curvature: float = 0.0
    latent: float = 1e-3
    perceptual: float = 0.1
    scan: float = 1.0
    scan_normal: float = 0.1

    def __post_init__(self) -> None:
        for name in ("phi", "psi", "pose", "features", "rays", "gaussians", "scattered"):
            if getattr(self, name) < 1:
                raise InputError(f"palm: {name} is {getattr(self, name)}; give at least 1")
        if self.places is not None and self.places < 1:
            raise InputError(f"palm: places is {self.places}; give at least 1, or none for one a direction")
        if not self.geometry:
            raise InputError("palm: geometry is (); give the width of at least one hidden layer")
        if self.beta <= 0.0 or self.reach <= 0.0:
            raise InputError(f"palm: beta is {self.beta} and reach {self.reach}; give metres above 0")
        if not 0 <= self.bones <= 4:
            raise InputError(f"palm: bones is {self.bones}; search roots from 1 to 4 nearest ones, or 0 for all")

    @property
    def starts(self) -> Starts:
        return NearestBones(self.bones) if self.bones else AllBones()

    @property
    def marching(self) -> Marching:
        return Marching(self.step, self.samples, self.softness)

    def budget(self, steps: int) -> Budget:
        return Budget(steps, 1, self.rate, self.warmup, betas=(0.9, 0.99))


_SEED = PalmConfig(
    canonical="subject",
    bones=0,
    encoding="hash",
    levels=16,
    table=19,
    finest=2048.0,
    geometry=(128,) * 4,
    appearance=(128,) * 4,
    material=(128,) * 4,
    phi=32,
    psi=32,
    pose=32,
    shape=16,
    skin_features=None,
    modulated=False,
    lipschitz=False,
    beta=1e-2,
    samples=64,
    refine=32,
    reach=15e-3,
    geometry_steps=0,
    steps=200_000,
    normals_from=0.25,
    light_from=0.5,
    rays=1024,
    patch=32,
    scan_points=0,
    scattered=64,
    places=None,
    gaussians=8,
    register=False,
    rate=(5e-4, 5e-5),
    warmup=0,
    curvature=0.1,
)

PRESETS = {
    "smoke": PalmConfig(
        grids=(8, 16),
        plane=32,
        geometry=(32,),
        appearance=(32,),
        material=(32,),
        samples=6,
        geometry_steps=30,
        steps=20,
        rays=64,
        patch=16,
        scan_points=256,
        scattered=24,
        register=False,
    ),
    "quick": PalmConfig(),
    "seed": _SEED,
    # what the authors' code does differently from the seed's text
    "released": replace(
        _SEED,
        spacing=5.2e-3,
        normals="rotation",
        levels=32,
        finest=16 * 1.447**31,
        geometry=(64,),
        appearance=(64, 64),
        material=(64, 64),
        shape=0,
        lipschitz=True,
        beta=0.3,
        step=4.06e-3,
        samples=32,
        geometry_steps=2000,
        steps=24_000,
        scattered=512,
        gaussians=64,
        rate=(1e-3, 1e-3),
        warmup=1000,
        eikonal=1e-5,
        scan=2.0,
    ),
    # the seed with constants of a hand where the code has those of a body, and one canonical space
    "hand-scale": replace(
        _SEED,
        canonical="shared",
        bones=2,
        levels=12,
        finest=1024.0,
        geometry=(64,),
        appearance=(64, 64),
        material=(64, 64),
        lipschitz=True,
        beta=3e-3,
        samples=24,
        refine=16,
        reach=8e-3,
        steps=24_000,
        scattered=128,
        places=1,
        gaussians=64,
        rate=(1e-3, 1e-4),
        warmup=500,
    ),
}
