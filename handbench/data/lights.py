"""A light as it is named on a command line or in a protocol: a map's file or a skybox, turned and exposed.

    studio.exr      studio.hdr:rotate=90      hall:exposure=-1      sunny.exr:rotate=30,exposure=0.5,clip

`rotate` turns the map about +y in degrees, right-handed: what was at +z comes to +x at 90. `exposure` is in stops:
each doubles the radiance. `clip` takes 0 for negative and 65504 for infinite radiance, instead of refusing them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError, shortened, unknown_name
from ..light.environment import resize, rotate
from ..light.skybox import SKYBOXES, skybox
from ..scene import Environment
from .environments import read_environment
from .options import split_options

_HIGHEST = 256
"""Rows of a map that is kept: methods reduce it to far fewer, and a turning light is turned in every frame."""
_STOPS = 30.0
_HALF = 65504.0
_SUN = 0.02  # share of the texels at the greatest half float from which on they are no sun but a fault of the file


@dataclass(frozen=True)
class NamedLight:
    """A map's file or the name of a skybox, `rotate` in degrees about +y, `exposure` in stops, and whether to clip."""

    source: str
    rotate: float = 0.0
    exposure: float = 0.0
    clip: bool = False

    @classmethod
    def parse(cls, text: str) -> NamedLight:
        """`SOURCE[:OPTION,…]`. Raises `InputError` for an option that there is not, or a value that is no number."""
        source, values = split_options(text, "light", ("rotate", "exposure"), ("clip",))
        if not source:
            raise InputError(f"light {shortened(text)} names no map; give a file, or one of {', '.join(SKYBOXES)}")
        if abs(exposure := values.get("exposure", 0.0)) > _STOPS:
            raise InputError(f"light {shortened(text)}: exposure is {exposure:g} stops; give -{_STOPS:g} to {_STOPS:g}")
        return cls(source, values.get("rotate", 0.0), exposure, "clip" in values)

    @property
    def label(self) -> str:
        """The map's name, and what was done to it."""
        done = [f"{name} {value:g}" for name, value in (("rotate", self.rotate), ("exposure", self.exposure)) if value]
        return ", ".join([self.source if self.is_skybox else Path(self.source).stem, *done])

    @property
    def is_skybox(self) -> bool:
        return self.source in SKYBOXES and not Path(self.source).is_file()

    def read(self, tell: Callable[[str], None] = lambda remark: None) -> Environment:
        """The light, of at most 256 x 512 texels with its power kept; `tell` hears what is to be known of the file.

        Raises `InputError` for a file that is missing or damaged, as `read_environment` does, and for an unknown name.
        """
        if self.is_skybox:
            found = skybox(self.source, _HIGHEST, 2 * _HIGHEST)
        elif Path(self.source).suffix or Path(self.source).exists():
            found = read_environment(Path(self.source), clip=self.clip)
            for remark in _remarks(self.source, found):
                tell(remark)
        else:
            raise unknown_name("skybox", self.source, SKYBOXES)
        if found.radiance.shape[0] > _HIGHEST:
            found = resize(found, _HIGHEST, 2 * _HIGHEST)
        if self.rotate:
            found = rotate(found, np.radians(self.rotate))
        radiance = found.radiance.astype(np.float64) * 2.0**self.exposure
        if radiance.max() > np.finfo(np.float32).max:
            raise InputError(f"light {self.label} is brighter than a float can hold; give a lower exposure")
        return Environment(self.label, radiance)

    @property
    def digest(self) -> str:
        """Of what the light is: content of the file, and options."""
        content = self.source.encode() if self.is_skybox else Path(self.source).read_bytes()
        return hashlib.sha256(f"{self.rotate} {self.exposure} {self.clip} ".encode() + content).hexdigest()[:16]


def _remarks(source: str, environment: Environment) -> Iterator[str]:
    """A sun that half floats cut off, a map without light."""
    radiance = environment.radiance
    cut = int((radiance >= _HALF).any(axis=-1).sum())
    if 0 < cut < _SUN * radiance[..., 0].size:
        yield (
            f"{source}: {cut} texels are at {_HALF:g} or above, the greatest half float; if the file went through half "
            "floats, its sun is cut off, and what it lights is too dark"
        )
    if not radiance.any():
        yield f"{source}: the map is black everywhere"
