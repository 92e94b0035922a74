"""What the pictures of an enrolment show of a fitted hand's texture, texel by texel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from handbench.errors import Unsupported
from handbench.hand.twins import completed
from handbench.method import Recording
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.unwrap import averaged
from handbench.scene import Array, needed

from ..kit.fittedhand import FittedHand


@dataclass(frozen=True)
class UnwrappedPicture:
    """One picture at the N texels of an atlas: colour (3, N), unit normal (N, 3) in the world, and weight (N,), zero
    where the picture does not show the texel."""

    colour: Array
    normal: Array
    weight: Array


@dataclass(frozen=True)
class Unwrapped:
    """The pictures of an enrolment as textures; `mean` (3, N) of them, which texels were `seen` (N,), and the mean
    colour (3,) of the pictures' foreground."""

    hand: FittedHand
    atlas: Atlas
    pictures: tuple[UnwrappedPicture, ...]
    mean: Array
    seen: Array
    foreground: Array

    def texture(self, colour: Array) -> Tensor:
        """The whole texture (3, R, R) of colours (3, N) of which only those seen count; the others are filled in."""
        found = completed(self.hand.hand, self.hand.level, self.atlas, colour, self.seen).colour
        return self.atlas.dilate(self.atlas.scatter(torch.from_numpy(found).float()))


def unwrapped(hand: FittedHand, enrolment: Recording, size: int) -> Unwrapped:
    """The pictures in which a hand was found, at textures of size x size.

    Raises `Unsupported` if they show nothing of it.
    """
    shown = list(hand.shown(enrolment, size))
    mean = averaged(picture.seen for picture in shown)
    if not mean.seen.any():
        raise Unsupported(f"the pictures of {enrolment.subjects[0]} show nothing of the fitted hand; check the masks")
    total, count = np.zeros(3), 0.0
    for picture in shown:
        seen = enrolment.observe(picture.frame)
        alpha = needed(seen.alpha, "alpha")
        total += seen.image[alpha > 0.5].sum(axis=0, dtype=np.float64)
        count += float((alpha > 0.5).sum())
    pictures = tuple(UnwrappedPicture(each.seen.colour, each.surface.normal, each.seen.weight) for each in shown)
    foreground = np.maximum(total / count, 1e-6)
    return Unwrapped(hand, hand.atlas(size), pictures, mean.colour, mean.seen, foreground)
