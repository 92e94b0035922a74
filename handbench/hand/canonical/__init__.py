"""From a posed hand back to the hand at rest, for any hand model: skinning weights in space, and roots of skinning.

SNARF (Chen et al. 2021) with the weights of the hand model instead of learned ones, as PALM-Net uses it:

    field = WeightField.of(hand)                            once a hand model (or once a person)
    deformation = Deformation(field, shape, joints)         a pose: where points at rest go
    roots = canonicalise(deformation, points)               where posed points came from, all candidates
    x = attached(deformation, points, roots.x[:, 0])        with gradients to shape, joints and points
"""

from __future__ import annotations

from .deformation import Deformation
from .roots import AllBones, NearestBones, Roots, Starts, attached, canonicalise
from .weightfield import WeightField, skinning_weights

__all__ = [
    "AllBones",
    "Deformation",
    "NearestBones",
    "Roots",
    "Starts",
    "WeightField",
    "attached",
    "canonicalise",
    "skinning_weights",
]
