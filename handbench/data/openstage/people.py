"""People: the look of anybody's skin, drawn from a declared distribution of tones, ages and habits."""

from __future__ import annotations

import numpy as np

from .nails import NailLook
from .skin import SkinLook
from .tattoo import HELD_OUT, TATTOOS, Tattoo

_DARK = ((0.010, 0.007, 0.005), (0.022, 0.013, 0.008))  # hair, linear RGB
_FAIR = ((0.022, 0.013, 0.008), (0.09, 0.05, 0.025), (0.24, 0.15, 0.07), (0.16, 0.06, 0.02))
_GREY = (0.42, 0.40, 0.37)
_POLISH = (
    (0.45, 0.02, 0.04),
    (0.02, 0.06, 0.30),
    (0.02, 0.02, 0.02),
    (0.30, 0.05, 0.20),
    (0.62, 0.36, 0.33),
    (0.70, 0.68, 0.62),
    (0.05, 0.25, 0.22),
    (0.16, 0.02, 0.05),
)
SEEN_TATTOOS = tuple(name for name in TATTOOS if name not in HELD_OUT)


def look(seed: int, melanin: float | None = None, tattoos: tuple[str, ...] = SEEN_TATTOOS) -> SkinLook:
    """The look of person number `seed`: the same number is the same person.

    Tones are those of `tone_of`, unless `melanin` says one. Ages are even from 18 to 80; a third are very hairy;
    one in four wears polish, two in five have tattoos (of those named), a few birthmarks or no pigment in places.
    """
    rng = np.random.default_rng([2402, seed])
    if melanin is None:
        melanin = tone_of(seed)
    age = rng.uniform(18, 80)
    old = float(np.clip((age - 40) / 40, 0, 1))
    sleeve = rng.random() < 0.4
    hairy = rng.random() < 0.34
    return SkinLook(
        melanin=melanin,
        haemoglobin=float(rng.uniform(0.32, 0.68)),
        warmth=float(rng.uniform(0, 1)),
        freckles=float(rng.uniform(0, 1) ** (1 + 4 * melanin)),
        creases=float(rng.uniform(0.65, 1.0) + 0.35 * old),
        roughness=float(rng.uniform(0.34, 0.46)),
        veins=float(np.clip(rng.uniform(0.1, 1.0) + 0.2 * old, 0, 1)),
        mottling=float(rng.uniform(0.3, 1.0)),
        spots=float(rng.uniform(0.2, 1.0) * old),
        joints=float(rng.uniform(0.2, 1.0)),
        tan=float(rng.uniform(0, 1)),
        hair=float(rng.uniform(0.45, 1.0) if hairy else rng.uniform(0.0, 0.3)),
        hair_colour=_hair_colour(rng, melanin, age),
        birthmarks=int(rng.random() < 0.15) * int(rng.integers(1, 3)),
        bleached=int(rng.random() < 0.03) * int(rng.integers(3, 9)),
        scars=int(rng.poisson(1.5)),
        sleeve=float(rng.uniform(-0.08, 0.0)) if sleeve else None,
        ring=int(rng.choice([1, 2, 3, 3, 3, 4])) if rng.random() < 0.4 else None,
        watch=bool(rng.random() < 0.2),
        nails=_nails(rng),
        tattoos=_tattoos(rng, tattoos) if rng.random() < 0.4 else (),
        seed=seed,
    )


def tone_of(seed: int) -> float:
    """Melanin of person number `seed`: of density 6 m (1 - m), every tone between very light 0 and very dark 1.

    The numbers in a row spread evenly over the distribution (van der Corput), so a few people already have all tones.
    """
    even = int(f"{seed + 1:032b}"[::-1], 2) / 2**32
    return float(0.5 - np.sin(np.arcsin(1 - 2 * even) / 3))


def _hair_colour(rng: np.random.Generator, melanin: float, age: float) -> tuple[float, float, float]:
    colours = _FAIR if melanin < 0.35 else _DARK
    colour = np.array(colours[int(rng.random() * len(colours))])
    grey = float(np.clip((age - 45) / 30 + rng.normal(0, 0.2), 0, 0.9))
    red, green, blue = colour + grey * (np.array(_GREY) - colour)
    return float(red), float(green), float(blue)


def _nails(rng: np.random.Generator) -> NailLook:
    polished = rng.random() < 0.25
    return NailLook(
        shape=float(rng.uniform(0, 1)),
        length=float(rng.uniform(0.45, 1.0) if polished else rng.beta(2, 3)),
        lunula=float(rng.uniform(0, 1)),
        ridges=float(rng.uniform(0.1, 1.0)),
        polish=_POLISH[rng.integers(len(_POLISH))] if polished else None,
        tips=bool(polished and rng.random() < 0.15),
    )


def _tattoos(rng: np.random.Generator, names: tuple[str, ...]) -> tuple[Tattoo, ...]:
    """One on the hand, on the forearm, or several."""
    hand = Tattoo(
        str(rng.choice(names)),
        float(rng.uniform(-0.012, 0.006)),
        float(rng.uniform(0.038, 0.058)),
        float(rng.uniform(0.012, 0.022)),
        float(rng.normal(0, 0.3)),
    )
    arms = [
        Tattoo(
            str(rng.choice(names)),
            float(rng.uniform(-0.006, 0.006)),
            y,
            float(rng.uniform(0.018, 0.024)),
            float(rng.normal(0, 0.2)),
        )
        for y in (-0.045, -0.085)
    ]
    kind = rng.choice(4, p=(0.2, 0.25, 0.2, 0.35))
    return ((hand,), (arms[0],), (hand, arms[1]), (*arms, hand))[kind]
