"""Which parts of a ray are looked at: those near a surface, and there more closely where light is absorbed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ...errors import InputError
from ...skips import note, skips
from .quadrature import laplace_density, weights
from .shell import Shell

_FLOOR = 0.1  # of the samples are spread evenly over all that is not skipped
_SATURATED = 1e-3  # transmittance from which on a ray is given up


@dataclass(frozen=True)
class Marching:
    """How rays are cut into intervals.

    step        metres of the first, even cut
    samples     intervals of a ray that are kept, chosen by how much light they should absorb
    softness    metres: how far the surface is expected to be from the shell's mesh
    """

    step: float = 2e-3
    samples: int = 12
    softness: float = 2e-3

    def __post_init__(self) -> None:
        for name in ("step", "samples", "softness"):
            if not getattr(self, name) > 0:
                raise InputError(f"marching: {name} is {getattr(self, name)}; give a number above 0")


@dataclass(frozen=True, eq=False)
class Intervals:
    """Of some rays the parts that are looked at: S intervals each, front to back.

    ray (Q,)            which of the R rays they are of; others have none
    middle, length (Q, S)   metres along the ray: where each is sampled, and how much of the ray it stands for
    total               R
    """

    ray: Tensor
    middle: Tensor
    length: Tensor
    total: int


def crossed(box: Tensor, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
    """Where rays (R, 3) enter and leave a box (2, 3): distances (R,) ahead of origins, enter < leave if at all."""
    towards = torch.where(directions.abs() < 1e-12, 1e-12, directions)
    first, second = (box[0] - origins) / towards, (box[1] - origins) / towards
    enter, leave = torch.minimum(first, second).amax(dim=1), torch.maximum(first, second).amin(dim=1)
    return enter.clamp_min(0.0), leave


@torch.no_grad()
def through(
    shell: Shell,
    origins: Tensor,
    directions: Tensor,
    marching: Marching,
    rng: np.random.Generator | None = None,
) -> Intervals:
    """The intervals of rays with origins (R, 3) and unit directions (R, 3) through a shell.

    Rays are cut into even steps. What a surface at the shell's mesh, as soft as `marching.softness`, would absorb in
    each step tells where to look: `samples` intervals of equal shares of that. With an rng the cuts and the places of
    samples are random (stratified), else in the middle.

    Skips, each noted: rays that miss the box (`outside_box`, "rays"); steps out of the shell's reach (`empty_space`,
    "ray steps"); steps behind which 99.9 % are absorbed already (`saturated`, "ray steps behind"). Without
    `empty_space` every even step is an interval of its own: the reference.
    """
    enter, leave = crossed(shell.box, origins, directions)
    hits = (leave > enter).nonzero()[:, 0] if skips().outside_box else torch.arange(len(origins))
    note("rays", len(origins), len(origins) - len(hits))
    enter, leave = enter[hits], leave[hits].maximum(enter[hits])
    longest = float((leave - enter).max()) if len(hits) else 0.0
    count = max(1, int(np.ceil(longest / marching.step)))
    cut = (torch.arange(count) + _uniform(rng, len(hits), 1)) * marching.step
    middle = enter[:, None] + cut
    inside = middle < leave[:, None]
    length = marching.step * inside.float()
    if not skips().empty_space:
        return Intervals(hits, middle, length, len(origins))
    points = origins[hits, None] + middle[..., None] * directions[hits, None]
    distance = shell.at(points.reshape(-1, 3)).view(middle.shape)
    near = inside & (distance.abs() < shell.reach)
    note("ray steps", int(inside.sum()), int(inside.sum() - near.sum()))
    share = weights(laplace_density(distance.nan_to_num(posinf=1.0), marching.softness), length)
    if skips().saturated:
        passed = 1.0 - share.cumsum(dim=1) + share
        behind = near & (passed < _SATURATED)
        note("ray steps behind", int(near.sum()), int(behind.sum()))
        near &= ~behind
    some = near.any(dim=1)
    hits, length, share = hits[some], length[some] * near[some], share[some]
    begin = (middle[some] - 0.5 * marching.step).contiguous()
    return Intervals(hits, *_resampled(begin, length, share, marching.samples, rng), len(origins))


@torch.no_grad()
def refined(intervals: Intervals, share: Tensor, count: int, rng: np.random.Generator | None = None) -> Intervals:
    """`count` new intervals a ray, where the given ones had their weights, share (Q, S): proposal resampling."""
    begin = intervals.middle - 0.5 * intervals.length
    middle, length = _resampled(begin, intervals.length, share, count, rng)
    return replace(intervals, middle=middle, length=length)


def _resampled(
    begin: Tensor, length: Tensor, share: Tensor, count: int, rng: np.random.Generator | None
) -> tuple[Tensor, Tensor]:
    """Middles and lengths (Q, count) of new intervals out of B old ones, between which equal shares (Q, B) of them lie.

    A new interval stands for as many metres as lie between its cuts, wherever they are. Some samples (`_FLOOR`) are
    spread by length alone.
    """
    even = length / length.sum(dim=1, keepdim=True)
    pdf = share * (length > 0) + _FLOOR * (share.sum(dim=1, keepdim=True) + 1e-4) * even
    travelled = torch.cat([torch.zeros_like(length[:, :1]), length.cumsum(dim=1)], dim=1)
    cuts = _quantiles(pdf, travelled, count, rng)
    along = (0.5 * (cuts[:, 1:] + cuts[:, :-1])).contiguous()
    old = (torch.searchsorted(travelled, along, right=True) - 1).clamp(0, length.shape[1] - 1)
    return begin.gather(1, old) + along - travelled.gather(1, old), cuts[:, 1:] - cuts[:, :-1]


def _quantiles(pdf: Tensor, travelled: Tensor, count: int, rng: np.random.Generator | None) -> Tensor:
    """Cuts (Q, count + 1) of the way `travelled` (Q, B + 1), between which equal shares of pdf (Q, B) lie."""
    cdf = torch.cat([torch.zeros_like(pdf[:, :1]), pdf.cumsum(dim=1)], dim=1)
    cdf = cdf / cdf[:, -1:]
    inner = (torch.arange(1, count) + (_uniform(rng, len(pdf), count - 1) - 0.5)) / count
    targets = inner.expand(len(pdf), -1).contiguous()
    upper = torch.searchsorted(cdf, targets, right=True).clamp(1, pdf.shape[1])
    low, high = cdf.gather(1, upper - 1), cdf.gather(1, upper)
    part = ((targets - low) / (high - low).clamp_min(1e-9)).clamp(0.0, 1.0)
    first, second = travelled.gather(1, upper - 1), travelled.gather(1, upper)
    middle = first + part * (second - first)
    return torch.cat([travelled[:, :1], middle, travelled[:, -1:]], dim=1)


def _uniform(rng: np.random.Generator | None, rows: int, columns: int) -> Tensor:
    """Random numbers (rows, columns) in [0, 1), or one half for all."""
    if rng is None:
        return torch.full((1, columns), 0.5)
    return torch.from_numpy(rng.random((rows, columns), dtype=np.float32))
