"""What a scene doesn't need: one switch a skip, and a tally of what the skips saved.

    with skipping(Skips(below_horizon=False)):      # one skip off
        avatar.relight(query)
    with tallied() as tally:                        # what was done and what was not
        avatar.relight(query)
    tally.lines()                                   # {"shadow rays": Saved(total=…, skipped=…), …}

Code that can skip asks `skips()` and says with `note` how much there was and how much it left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, fields

from .errors import InputError


@dataclass(frozen=True)
class Skips:
    """Which skips are on.

    dark_lights     lights without power
    faint_lights    the greatest share of a light's whole power that its faintest parts, left out together, may have
    below_horizon   texel-light pairs below the horizon
    agreed          shadow rays of many lights at texels between others that agree
    uncovered       texels that no triangle covers
    unseen          texels that no pixel looks up, for methods that shade texel by texel; where a network looks at them
                    too, the light of an environment at most of them
    occluded        blocks of texel-light pairs that are all in shadow
    missing_lobes   the specular lobe where a model or a method has none
    outside_box     pixels outside the boxes of the hand's triangles, and rays that miss the hand's box
    empty_space     parts of a ray through a volume that are out of a surface's reach
    saturated       parts of a ray through a volume behind which nothing is seen any more
    weightless      samples of a volume that contribute next to nothing to their pixel
    known           what a posed avatar or surface worked out for earlier lights
    """

    dark_lights: bool = True
    faint_lights: float = 0.0
    below_horizon: bool = True
    agreed: bool = True
    uncovered: bool = True
    unseen: bool = True
    occluded: bool = True
    missing_lobes: bool = True
    outside_box: bool = True
    empty_space: bool = True
    saturated: bool = True
    weightless: bool = True
    known: bool = True

    def __post_init__(self) -> None:
        if not 0.0 <= self.faint_lights < 1.0:
            raise InputError(f"skips: faint_lights is {self.faint_lights}; give a share of power in [0, 1)")


NONE = Skips(**{f.name: False for f in fields(Skips) if f.name != "faint_lights"})
"""Every skip off: the reference that skipping is held against."""


@dataclass(frozen=True)
class Saved:
    """How much there was, and how much of it was left out."""

    total: int
    skipped: int


@dataclass
class Tally:
    """Sums of what was noted, by the name of what was skipped ("shadow rays", "lights", …)."""

    _sums: dict[str, Saved] = field(default_factory=dict)

    def add(self, what: str, total: int, skipped: int) -> None:
        before = self._sums.get(what, Saved(0, 0))
        self._sums[what] = Saved(before.total + int(total), before.skipped + int(skipped))

    def lines(self) -> dict[str, Saved]:
        """In the order in which things were first noted."""
        return dict(self._sums)


_ALL = Skips()
_current: ContextVar[Skips] = ContextVar("skips", default=_ALL)
_tallies: ContextVar[tuple[Tally, ...]] = ContextVar("tallies", default=())


def skips() -> Skips:
    """The skips that are on here."""
    return _current.get()


@contextmanager
def skipping(chosen: Skips) -> Iterator[None]:
    """Use other skips inside the block."""
    before = _current.set(chosen)
    try:
        yield
    finally:
        _current.reset(before)


@contextmanager
def tallied() -> Iterator[Tally]:
    """Count what is skipped inside the block; blocks nest, and the outer one counts too."""
    tally = Tally()
    before = _tallies.set((*_tallies.get(), tally))
    try:
        yield tally
    finally:
        _tallies.reset(before)


def note(what: str, total: int, skipped: int) -> None:
    """Tell every tally around that of `total` things `skipped` were left out. Does next to nothing without one."""
    for tally in _tallies.get():
        tally.add(what, total, skipped)
