"""Whether light adds in an avatar's answers: additivity and homogeneity as numbers, measured with its own queries."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Protocol

import numpy as np

from ..errors import text_of
from ..method import Avatar, PosedAvatar
from ..scene import Array, Frame, Group, Light, Query
from .measured import Laws

LINEAR = 1e-4  # greatest deviation of a method that is declared linear: what float32 sums in another order may leave
SCALES = (0.7, 1.9)  # what the lights of a pair are scaled by
_STAGE, _ENVIRONMENTS = 3, 2  # lights of each sort


class Draw(Protocol):
    def __call__(self, light: Light, factor: float = 1.0) -> Array: ...


@dataclass(frozen=True)
class Deviations:
    """Greatest differences of pictures that linearity in light makes equal, relative to the brightest pixel.

    additivity    render(a L1 + b L2) from render(a L1) + render(b L2)
    homogeneity   render(a L1) from a render(L1), and the same of b L2
    linearity     render(a L1 + b L2) from a render(L1) + b render(L2)
    """

    additivity: float
    homogeneity: float
    linearity: float


def drawing(avatar: Avatar, query: Query) -> Draw:
    """A function that gives the float64 picture (H, W, 3) of a query under a light times a factor, each drawn once."""

    @cache
    def posed() -> PosedAvatar:
        return avatar.pose(query.viewpoint)

    @cache
    def draw(light: Light, factor: float = 1.0) -> Array:
        return posed().relight(Group((light,)).scaled(factor)).image.astype(np.float64)

    return draw


def deviations(draw: Draw, one: Light, other: Light, scales: tuple[float, float] = SCALES) -> Deviations:
    """The deviations of a pair of lights, infinite for pictures that are not finite. Raises what `draw` raises."""
    a, b = scales
    both = draw(Group((one.scaled(a), other.scaled(b))))
    return Deviations(
        _apart(both, draw(one, a) + draw(other, b)),
        max(_apart(draw(one, a), a * draw(one)), _apart(draw(other, b), b * draw(other))),
        _apart(both, a * draw(one) + b * draw(other)),
    )


def _apart(one: Array, other: Array) -> float:
    return deviation(one, other) if np.isfinite(one).all() else float("inf")


def measured_laws(avatar: Avatar, frames: Sequence[Frame], query: Query) -> Laws:
    """The greatest deviations of an avatar: lights of scored frames in a query's pose and camera.

    One pose and camera, and lights that are drawn once, keep this cheap. A pair that the method cannot draw is left
    out; None stands for no pair, and for pictures with NaN or infinity.
    """
    draw = drawing(avatar, query)
    found, reason = [], None
    for one, other in pairs_of(frames, zlib.crc32(query.key.encode())):
        try:
            found.append(deviations(draw, one, other))
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # the scores tell of a method that fails; here only that a pair is missing
            reason = f"{type(error).__name__}: {text_of(error)}"
    worst = {f.name: max((getattr(d, f.name) for d in found), default=np.inf) for f in fields(Deviations)}
    values = {name: value if np.isfinite(value) else None for name, value in worst.items()}
    if found and None in values.values():
        reason = "non-finite: a picture has NaN or infinity"
    return Laws(**values, pairs=len(found), reason=reason)


def pairs_of(frames: Sequence[Frame], seed: int) -> list[tuple[Light, Light]]:
    """Pairs of the frames' lights: a chain of stage lights, of as many kinds as there are, and one of environments.

    A chain of one light is paired with itself. The two are not mixed: no capture does, and methods are slow at it.
    """
    lights = {frame.lighting: frame for frame in frames}
    order = np.random.default_rng(seed).permutation(len(lights))
    shuffled = [lights[sorted(lights)[i]] for i in order]
    pairs: list[tuple[Light, Light]] = []
    for length, environment in ((_STAGE, False), (_ENVIRONMENTS, True)):
        left = [frame for frame in shuffled if (frame.kind == "environment") == environment]
        chain: list[Frame] = []
        while left and len(chain) < length:
            kinds = [frame.kind for frame in chain]
            chain.append(left.pop(int(np.argmin([kinds.count(frame.kind) for frame in left]))))
        # Every other pair is turned, so that a light is only ever the first or the second of its pairs: fewer draws.
        for i, (one, other) in enumerate(zip(chain, chain[1:] or chain, strict=False)):
            pairs.append((one.light, other.light) if i % 2 == 0 else (other.light, one.light))
    return pairs


def deviation(one: Array, other: Array) -> float:
    """Largest difference, relative to the brightest pixel of either; infinite if only one is finite somewhere."""
    if one.shape != other.shape or (np.isfinite(one) != np.isfinite(other)).any():
        return float("inf")
    finite = np.isfinite(one)
    if not finite.any():
        return 0.0
    scale = max(float(np.abs(one[finite]).max()), float(np.abs(other[finite]).max()), 1e-12)
    return float(np.abs(one[finite].astype(np.float64) - other[finite]).max()) / scale
