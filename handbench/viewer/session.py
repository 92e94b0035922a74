"""What a viewer shows: pictures of avatars, drawn when they are asked for. What a pose needs is kept for the next."""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from PIL import Image

from ..avatars.portrait import Held, Portrait
from ..avatars.repertoire import orbited, resized
from ..data.lights import NamedLight
from ..errors import InputError, NonFinite
from ..light.environment import resize, rotate
from ..light.reduction import reduced
from ..method import PosedAvatar
from ..relighting.showing import EXPOSED
from ..scene import Array, Camera, Directional, Environment, Group, Light, Prediction
from ..scene.colour import eight_bit
from ..tuning import tune

_MAP = (64, 128)
"""Texels of a map that is turned live: methods reduce it to 16 x 32 or fewer."""
_QUALITY = 90
_FEW = 16
"""Distant lights that stand for a map in drafts: their shadows are most of a new pose. 24 or 40 are hardly nearer to
pictures under the map."""
KEPT = 12
"""Poses of an avatar that are kept, those that were shown last: going back to one costs no more than turning it."""


@dataclass(frozen=True)
class Glance:
    """What is asked of an avatar: a pose and a camera by number, the camera's way around the hand in degrees, its zoom,
    a map by number, the light's turn in degrees, stops of exposure beside what suits the map; and with `draft` 1 a
    picture of half as many pixels both ways under few lights in the map's place, for while something moves."""

    avatar: int
    pose: int = 0
    yaw: float = 0.0
    pitch: float = 0.0
    zoom: float = 1.0
    light: int = 0
    turn: float = 0.0
    exposure: float = 0.0
    draft: int = 0


@dataclass(frozen=True)
class Drawn:
    """A picture as the bytes of a JPEG, and the milliseconds it took."""

    jpeg: bytes
    ms: float


class Session:
    """Avatars, maps, the size of pictures, and how many poses are kept. Pictures of one avatar are drawn one after the
    other."""

    def __init__(
        self, portraits: Sequence[Portrait], lights: Sequence[NamedLight], size: tuple[int, int], kept: int = KEPT
    ) -> None:
        tune()
        self.portraits, self.lights, self.size, self.kept = tuple(portraits), tuple(lights), size, kept
        self.postures = [list(portrait.repertoire.postures.values()) for portrait in portraits]
        self._locks = [threading.Lock() for _ in portraits]
        self._held: list[dict[int, Held]] = [{} for _ in portraits]  # by pose, the last one shown at the end
        self._exposures: dict[int, float] = {}
        self._exposing = threading.Lock()
        self.map = lru_cache(maxsize=32)(self._map)
        self.few = lru_cache(maxsize=32)(self._few)

    def described(self) -> dict[str, Any]:
        """What the page needs to know, as JSON values."""
        return {
            "avatars": [
                {
                    "name": portrait.name,
                    "title": portrait.info.title,
                    "subject": portrait.repertoire.subject,
                    "poses": [posture.name for posture in postures],
                    "size": list(self.size),
                }
                for portrait, postures in zip(self.portraits, self.postures, strict=True)
            ],
            "lights": [light.label for light in self.lights],
        }

    def draw(self, view: Glance) -> Drawn:
        """The picture of a view. Raises `InputError` for a number that there is not, and what the method raises."""
        self._check(view)
        factor = self._exposure(view.light) * 2.0**view.exposure
        start = time.perf_counter()
        answer = self._drawn(view)
        picture = eight_bit(answer.image * np.float32(factor))
        out = io.BytesIO()
        Image.fromarray(picture).save(out, "JPEG", quality=_QUALITY, subsampling=0)
        return Drawn(out.getvalue(), 1e3 * (time.perf_counter() - start))

    def thumbnail(self, light: int, turn: float) -> bytes:
        """A map as it lights now, as the bytes of a JPEG."""
        if not 0 <= light < len(self.lights):
            raise InputError(f"there is no light {light}; give 0 to {len(self.lights) - 1}")
        radiance = self._turned(light, turn).radiance
        factor = np.float32(EXPOSED / max(float(np.percentile(radiance, 95)), 1e-6))
        out = io.BytesIO()
        Image.fromarray(eight_bit(radiance * factor)).save(out, "JPEG", quality=_QUALITY)
        return out.getvalue()

    def _drawn(self, view: Glance) -> Prediction:
        with self._locks[view.avatar]:
            answer = self._posed(view).relight(self._light(view))
        if not np.isfinite(answer.image).all():
            raise NonFinite(f"{self.portraits[view.avatar].name} drew values that are NaN or infinite")
        return answer

    def _posed(self, view: Glance) -> PosedAvatar:
        """The avatar in the view's pose, before its camera: a pose that is kept is turned, not posed anew."""
        portrait, posture = self.portraits[view.avatar], self.postures[view.avatar][view.pose]
        held = self._held[view.avatar]
        found = portrait.posed(portrait.repertoire.viewpoint(posture, self._camera(view)), held.pop(view.pose, None))
        held[view.pose] = found
        while len(held) > self.kept:
            del held[next(iter(held))]
        return found.posed

    def _camera(self, view: Glance) -> Camera:
        shown, posture = self.portraits[view.avatar].repertoire, self.postures[view.avatar][view.pose]
        width, height = (max(1, pixels // 2) for pixels in self.size) if view.draft else self.size
        camera = resized(shown.camera_of(posture.name), width, height)
        if (view.yaw, view.pitch, view.zoom) == (0.0, 0.0, 1.0):
            return camera
        return orbited(camera, shown.middle(posture), view.yaw, view.pitch, view.zoom)

    def _map(self, light: int) -> Environment:
        found = self.lights[light].read()
        for portrait in self.portraits:
            portrait.check(found)
        return resize(found, *_MAP)

    def _few(self, light: int) -> tuple[Array, Array]:
        """Directions (K, 3) and irradiance (K, 3) of few lights that stand for a map."""
        return reduced(self.map(light), _FEW)

    def _light(self, view: Glance) -> Light:
        """What lights a view: the map, and in drafts few lights that turn with it, so that shadows move evenly."""
        if not view.draft or "directional" not in self.portraits[view.avatar].info.lights:
            return self._turned(view.light, view.turn)
        directions, irradiance = self.few(view.light)
        turn = np.radians(view.turn)
        x, y, z = directions.T
        turned = np.stack([np.cos(turn) * x + np.sin(turn) * z, y, np.cos(turn) * z - np.sin(turn) * x], axis=1)
        return Group(tuple(Directional(*each) for each in zip(turned, irradiance, strict=True)))

    def _turned(self, light: int, turn: float) -> Environment:
        found: Environment = self.map(light)
        return found if turn % 360.0 == 0.0 else rotate(found, np.radians(turn))

    def _exposure(self, light: int) -> float:
        """The factor that suits a map, for all avatars: from the first one's first pose under it."""
        with self._exposing:
            if light not in self._exposures:
                answer = self._drawn(Glance(0, light=light))
                self._exposures[light] = EXPOSED / max(_bright(answer), 1e-6)
            return self._exposures[light]

    def _check(self, view: Glance) -> None:
        if not 0 <= view.avatar < len(self.portraits):
            raise InputError(f"there is no avatar {view.avatar}; give 0 to {len(self.portraits) - 1}")
        counts = {"pose": len(self.postures[view.avatar]), "light": len(self.lights)}
        for name, count in counts.items():
            if not 0 <= getattr(view, name) < count:
                raise InputError(f"there is no {name} {getattr(view, name)}; give 0 to {count - 1}")
        ranges = {"zoom": (0.1, 10.0), "exposure": (-20.0, 20.0), "pitch": (-180.0, 180.0), "draft": (0, 1)}
        for name, (low, high) in ranges.items():
            if not low <= getattr(view, name) <= high:
                raise InputError(f"{name} is {getattr(view, name):g}; give {low:g} to {high:g}")


def _bright(answer: Prediction) -> float:
    inside: Array = answer.image[answer.alpha > 0.5]
    return float(np.percentile(inside, 99)) if len(inside) else 1.0
