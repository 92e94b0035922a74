"""Texels that no picture saw: filled from a guide that knows what such skin looks like, or smoothly from around."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from ...errors import InputError
from ...scene import Array

NEIGHBOURS = 8
_DARKEST = 1e-3  # linear: ratios of colours below it mean nothing
_HOLD = 1e-6  # of an edge's weight: what keeps a patch without any seen texel at its guide, or the mean colour


@dataclass(frozen=True)
class Guide:
    """A texture whose structure unseen texels take: colour (C, N), valid (N,) bool, and a name for where it is from."""

    name: str
    colour: Array
    valid: Array


@dataclass(frozen=True)
class Inpainted:
    """colour (C, N), and where each texel's is from: `names[source]`, source (N,): "seen" (0), the name of a guide, or
    "smooth" (the last)."""

    colour: Array
    source: Array
    names: tuple[str, ...]


def inpainted(colour: Array, seen: Array, position: Array, guides: Sequence[Guide] = ()) -> Inpainted:
    """Colours (C, N) at texels with positions (N, 3) on the hand at rest, those not `seen` (N,) filled in.

    An unseen texel follows its first valid guide: not in colour, which is another finger's or person's, but in the
    ratio to its neighbours (in logarithms: a Poisson equation on the surface whose border are the seen texels; Perez et
    al. 2003). Without a guide the ratio is one, so colour spreads smoothly. Neighbours are near on the surface, not in
    the texture, so seams do not show. Raises `InputError` if nothing was seen.
    """
    if not seen.any():
        raise InputError(
            "no texel was seen by any picture, and there is nothing to fill in from; check mesh and cameras"
        )
    source = np.full(len(seen), len(guides) + 1)
    for number, guide in reversed(list(enumerate(guides, start=1))):
        source[guide.valid] = number
    source[seen] = 0
    known = np.log(np.maximum(colour, _DARKEST))
    mean = known[:, seen].mean(axis=1)
    log = [np.log(np.maximum(guide.colour, _DARKEST)) for guide in guides]

    near = cKDTree(position).query(position, k=min(NEIGHBOURS + 1, len(seen)))[1][:, 1:]
    first, second = np.arange(len(seen)).repeat(near.shape[1]), near.ravel()
    unseen = ~seen
    touching = unseen[first] | unseen[second]
    first, second = first[touching], second[touching]
    rule = np.where(unseen[first], source[first], source[second])
    step = np.zeros((len(colour), len(first)))  # log colour of the first less that of the second
    for number, guide in enumerate(guides, start=1):
        both = (rule == number) & guide.valid[first] & guide.valid[second]
        step[:, both] = log[number - 1][:, first[both]] - log[number - 1][:, second[both]]

    index = np.full(len(seen), -1)
    index[unseen] = np.arange(unseen.sum())
    count = int(unseen.sum())
    right = np.tile(_HOLD * mean[:, None], (1, count))
    rows, columns, values = [np.arange(count)], [np.arange(count)], [np.full(count, _HOLD)]
    for here, there, sign in ((first, second, 1.0), (second, first, -1.0)):
        own = unseen[here]
        i, other, ahead = index[here[own]], there[own], sign * step[:, own]
        rows.append(i)
        columns.append(i)
        values.append(np.ones(len(i)))
        inner = unseen[other]
        rows.append(i[inner])
        columns.append(index[other[inner]])
        values.append(np.full(int(inner.sum()), -1.0))
        for c in range(len(colour)):
            given = ahead[c] + np.where(inner, 0.0, known[c, other])
            right[c] += np.bincount(i, given, minlength=count)
    matrix = sp.coo_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (count, count))
    filled = colour.copy()
    if count:
        filled[:, unseen] = np.exp(splu(matrix.tocsc()).solve(right.T)).T
    each = ["seen", *(guide.name for guide in guides), "smooth"]
    names = tuple(dict.fromkeys(each))
    return Inpainted(filled, np.array([names.index(name) for name in each])[source], names)
