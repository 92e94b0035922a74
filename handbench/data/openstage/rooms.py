"""Environments beyond the sky boxes: a studio, rooms with lamps that cast shadows, and coloured panels."""

from __future__ import annotations

import numpy as np

from ...light.environment import directions
from ...light.skybox import skybox
from ...scene import Array, Environment
from .stage import exposed

_BOXES = (  # direction and half the angle across of the studio's soft boxes, in degrees, and their brightness
    ((0.6, 0.5, 0.8), 22.0, 9.0),
    ((-0.8, 0.3, 0.6), 18.0, 7.0),
    ((0.7, 0.4, -0.8), 22.0, 8.0),
    ((-0.6, 0.5, -0.8), 18.0, 7.0),
    ((0.0, 1.0, 0.0), 30.0, 5.0),
)
_PANELS = {  # direction, half the angle across in degrees, and colour
    "panels-fire": (
        ((1.0, 0.3, 0.5), 38.0, (9.0, 1.6, 0.3)),
        ((-1.0, 0.2, 0.4), 38.0, (0.3, 1.8, 9.0)),
        ((0.0, 1.0, -0.3), 30.0, (3.0, 0.4, 3.5)),
    ),
    "panels-leaf": (
        ((0.4, 0.2, 1.0), 34.0, (0.6, 6.0, 0.9)),
        ((-0.9, 0.5, -0.4), 40.0, (7.0, 0.5, 5.0)),
        ((0.8, -0.4, -0.6), 30.0, (6.0, 5.0, 0.4)),
    ),
}
PANELS = tuple(_PANELS)


def studio(height: int) -> Environment:
    """Soft boxes round a grey room: even light with soft shadows."""
    radiance = np.full((height, 2 * height, 3), 0.5)
    for towards, angle, brightness in _BOXES:
        radiance += brightness * _panel(height, towards, angle, soft=8.0)[..., None]
    return exposed(Environment("studio", radiance.astype(np.float32)))


def room(name: str, base: str, seed: int, height: int) -> Environment:
    """The sky box `base` turned about the vertical and dimmed, with two lamps in it that cast shadows."""
    rng = np.random.default_rng([511, seed])
    map_ = turned(name, base, int(rng.integers(2 * height)), height)
    radiance = 0.35 * np.minimum(map_.radiance, 6.0).astype(np.float64)
    azimuth = rng.uniform(0, 2 * np.pi)
    for share, turn in ((1.0, 0.0), (0.35, rng.uniform(1.6, 2.6))):
        up, around = rng.uniform(0.4, 0.9), azimuth + turn
        towards = (np.sin(around), up, np.cos(around))
        warmth = np.array([1.0, rng.uniform(0.75, 1.0), rng.uniform(0.5, 1.0)])
        radiance += share * 60.0 * warmth * _panel(height, towards, rng.uniform(5.0, 8.0), soft=2.0)[..., None]
    return exposed(Environment(name, radiance.astype(np.float32)))


def turned(name: str, base: str, columns: int, height: int) -> Environment:
    """The sky box `base` turned about the vertical by some of its columns."""
    raw = skybox(base, height, 2 * height)
    return exposed(Environment(name, np.roll(raw.radiance, columns, axis=1)))


def panels(name: str, height: int) -> Environment:
    """Large areas of strongly coloured light in a dark room: one of `PANELS`."""
    radiance = np.full((height, 2 * height, 3), 0.03)
    for towards, angle, colour in _PANELS[name]:
        radiance += np.asarray(colour) * _panel(height, towards, angle, soft=3.0)[..., None]
    return exposed(Environment(name, radiance.astype(np.float32)))


def _panel(height: int, towards: tuple[float, float, float], angle: float, soft: float) -> Array:
    """1 within `angle` degrees of a direction, 0 outside, falling over `soft` degrees, (height, 2 height)."""
    axis = np.asarray(towards) / np.linalg.norm(towards)
    off = np.degrees(np.arccos(np.clip(directions(height, 2 * height) @ axis, -1.0, 1.0)))
    return np.clip((angle + soft - off) / soft, 0.0, 1.0)
