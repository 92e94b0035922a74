"""The settings of PALM-Net as a method: of its prior, of how a person is found, and of how hands are drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from handbench.errors import InputError, unknown_name

from .config import PRESETS as PRIORS
from .config import PalmConfig
from .drawing import DrawingSettings
from .gathering import Gathering


@dataclass(frozen=True)
class FitWeights:
    """Of the losses: L1 of radiance field and of reflected light, mask, code, patches; released values.

    The released weight of a code is 1e-3 of its squares; of coefficients in standard deviations it is the same.
    """

    radiance: float = 1.0
    physical: float = 0.2
    mask: float = 0.1
    code: float = 1e-3
    perceptual: float = 0.1


@dataclass(frozen=True)
class FitRates:
    """Of Adam: codes, pose (radians, metres), shape (in standard deviations), light."""

    code: float = 5e-4
    pose: float = 1e-5
    shape: float = 1e-5
    light: float = 1e-3


@dataclass(frozen=True)
class PersonaliseSettings:
    """How a person is found in a picture.

    steps        of Adam, with `rays` and a patch of `patch` x `patch` pixels each (0: none); side: of the crop
    samples      directions of a ray's reflected light, each at a place of its own, or all at each of `places`
    components   of the training subjects' codes that are moved; whitened: in standard deviations about the mean of the
                 codes, or (released) unit vectors about zero
    lit_from     share of steps from which on reflected light counts and the light moves
    light        "fitted", or "fixed": the studio's, as bright as the picture (the seed's ablation)
    solved       whether a fitted light starts by least squares
    falling      share by which all rates fall to the end, in a straight line
    rebuild      steps between two searches for the places where the hand is, and for what it hides
    """

    steps: int = 5200
    rays: int = 256
    patch: int = 32
    side: int = 512
    samples: int = 512
    places: int | None = None
    components: int = 5
    whitened: bool = False
    lit_from: float = 0.385
    light: Literal["fitted", "fixed"] = "fitted"
    solved: bool = False
    falling: float = 0.0
    rebuild: int = 100
    weights: FitWeights = field(default_factory=FitWeights)
    rates: FitRates = field(default_factory=FitRates)

    def __post_init__(self) -> None:
        for name in ("rays", "side", "samples", "places", "components", "rebuild"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise InputError(f"palm-net: {name} of a fit is {value}; give at least 1")


@dataclass(frozen=True)
class PalmSettings:
    """One preset. What is changed in `prior` trains anew."""

    prior: PalmConfig
    fit: PersonaliseSettings
    drawing: DrawingSettings


_QUICK = PersonaliseSettings(
    steps=160,
    rays=192,
    patch=16,
    side=144,
    samples=128,
    places=1,
    components=8,
    whitened=True,
    lit_from=0.0,
    solved=True,
    rebuild=40,
    falling=0.9,
    weights=FitWeights(radiance=0.0, physical=1.0),
    rates=FitRates(code=0.04, pose=1e-4, shape=5e-3, light=0.02),
)
_PAPER = DrawingSettings(
    places="volume", scatter=64, visibility="march", gathering=Gathering(maps="light", directions=4096)
)
_FITS = {
    "smoke": replace(_QUICK, steps=12, rays=64, side=72, samples=32, components=2, rebuild=12),
    "quick": _QUICK,
    "seed": PersonaliseSettings(),
    "released": PersonaliseSettings(),
    "hand-scale": PersonaliseSettings(samples=256, places=1),
}
_DRAWINGS = {
    "smoke": DrawingSettings(spacing=4e-3, supersample=2),
    "quick": DrawingSettings(),
    "seed": _PAPER,
    "released": replace(_PAPER, visibility="body-march"),
    "hand-scale": _PAPER,
}
PRESETS = {name: PalmSettings(prior, _FITS[name], _DRAWINGS[name]) for name, prior in PRIORS.items()}


@dataclass(frozen=True)
class Ablation:
    """How a variant is called, what it leaves out, and the fields that it changes: of the prior, of the fit."""

    title: str
    summary: str
    prior: Mapping[str, Any]
    fit: Mapping[str, Any]


ABLATIONS: dict[str, Ablation] = {
    "no-normals": Ablation(
        "PALM-Net w/o normals", "a prior that learned without normals of its pictures", {"normal": 0.0}, {}
    ),
    "fixed-light": Ablation(
        "PALM-Net, fixed light",
        "the studio's light, as bright as the picture, instead of a fitted one",
        {},
        {"light": "fixed"},
    ),
}
"""Those of the seed's Sec. 7."""


def settings(preset: str, ablation: str | None) -> PalmSettings:
    """The settings of a preset and an ablation; `InputError` with the closest names for unknown ones."""
    if preset not in PRESETS:
        raise unknown_name("preset of palm-net", preset, PRESETS)
    chosen = PRESETS[preset]
    if ablation is None:
        return chosen
    if ablation not in ABLATIONS:
        raise unknown_name("ablation of palm-net", ablation, ABLATIONS)
    changed = ABLATIONS[ablation]
    return replace(chosen, prior=replace(chosen.prior, **changed.prior), fit=replace(chosen.fit, **changed.fit))
