"""Skinning weights all around a hand at rest, not on its surface alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from torch import Tensor

from ...errors import InputError
from ...lattice import Lattice
from ...scene import Array
from ..handmodel import HandModel

SPACING = 4e-3
"""Metres between nodes. Coarser ones blur the weights between neighbouring fingers."""

_NEAREST = 5  # vertices that a node takes its weights from
_LEAST = 1e-4  # metres: closer vertices count alike
_MARGIN = 0.02  # metres of the lattice around the hand


@dataclass(frozen=True, eq=False)
class WeightField:
    """What each node of a lattice around the hand at rest takes from the vertices that are nearest to it.

    hand        the hand model
    shape       (S,) of the hand that the lattice is around: canonical space
    lattice     of G nodes
    weights     (G, J) skinning weights of the nodes
    vertices    (G, k) vertices of `level` next to each node; share (G, k) of each, rows sum to one
    rest        (V, 3) vertices of `level` at rest
    coarse      (C, 3) those of level 0, and the bone (C,) that moves each most
    """

    hand: HandModel
    shape: Tensor
    level: int
    lattice: Lattice
    weights: Tensor
    vertices: Tensor
    share: Tensor
    rest: Tensor
    coarse: Tensor
    bone: Tensor

    @staticmethod
    def of(hand: HandModel, shape: ArrayLike | None = None, spacing: float = SPACING) -> WeightField:
        """The field around a shape at rest, by default the neutral one.

        A node takes the weights of its five nearest vertices, each by one over its distance, as PALM-Net's code does
        (a grid of 64^3 nodes, 5.2 mm apart). That code makes a field for each person; around the neutral hand one field
        serves all, and where a person's hand is larger or smaller is part of the deformation.

        Raises `InputError` for a hand model without skinning weights, and for a spacing of 0 or less.
        """
        if not spacing > 0.0:
            raise InputError(f"weight field: the spacing is {spacing}; give metres above 0")
        if shape is None:
            return _neutral(hand, spacing)
        level = min(1, hand.levels)
        known = skinning_weights(hand, level)
        around = torch.tensor(np.asarray(shape), dtype=torch.float32)
        coarse, _ = hand.rest_points(around)
        rest = hand.subdivide(coarse, level)
        lattice = Lattice.around(rest.numpy(), _MARGIN, spacing)
        distance, vertices = cKDTree(rest.numpy()).query(lattice.nodes().numpy(), _NEAREST)
        share = 1.0 / np.maximum(distance, _LEAST)
        share /= share.sum(axis=1, keepdims=True)
        weights = (known[vertices] * share[..., None]).sum(axis=1)
        near = torch.from_numpy(weights.astype(np.float32)), torch.from_numpy(vertices)
        shares = torch.from_numpy(share.astype(np.float32))
        bone = torch.from_numpy(np.asarray(hand.weights(0)).argmax(axis=1))
        return WeightField(hand, around, level, lattice, *near, shares, rest, coarse, bone)

    @property
    def box(self) -> Tensor:
        """The two corners (2, 3) of canonical space."""
        return torch.stack([self.lattice.low, self.lattice.high])

    def growth(self, shape: Tensor) -> Tensor:
        """How far the nodes (G, 3) move from this field's shape at rest to another one's; differentiable in it."""
        vertices = self.hand.subdivide(self.hand.rest_points(shape)[0].to(self.rest.dtype), self.level)
        moved = vertices - self.rest
        return (moved[self.vertices] * self.share[..., None]).sum(dim=1)


def skinning_weights(hand: HandModel, level: int) -> Array:
    """The weights (V, J) of a level's vertices. Raises `InputError` for a hand model that has none for each of them."""
    known = np.asarray(hand.weights(level))
    if known.ndim != 2 or known.shape[1] != len(hand.joint_names) or not known.any(axis=1).all():
        raise InputError(
            f"hand model {hand.name!r} has no skinning weights for each of its vertices (weights({level}) is "
            f"{known.shape}); canonicalisation needs them"
        )
    return known


def _neutral(hand: HandModel, spacing: float) -> WeightField:
    """The field around a hand model's neutral shape, which it keeps."""
    return hand.kept(("weight field", spacing), lambda: WeightField.of(hand, np.asarray(hand.neutral()), spacing))
