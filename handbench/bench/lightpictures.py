"""Pictures of the lights that frames are scored under, kept in a run folder so that its page can show them.

A picture is what the hand sees around it: up is up, the middle is +z, the edges are −z. A lamp is a disc.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import assert_never

import numpy as np

from ..errors import HandbenchError
from ..light.environment import directions, resize
from ..scene import Array, Directional, Environment, Frame, Light, Point, Unknown, leaves
from ..scene.colour import srgb

HEIGHT, WIDTH = 64, 128  # pixels
_RADIUS = np.radians(8.0)  # of a lamp's disc
_DISC = 2 * np.pi * (1 - np.cos(_RADIUS))  # its solid angle
_BRIGHT, _SHOWN = 0.9, 0.8  # this share of an environment is darker than what is shown as this
_NIGHT = 0.09  # what is shown where no light comes from, in sRGB


def panorama(light: Light, centre: Array | None) -> Array | None:
    """What is seen from a point (3,) of the world, (HEIGHT, WIDTH, 3) in sRGB.

    None of a light that is not known, and of a near one where the point is not known. The brightest lamp is white; an
    environment is exposed by itself, and what is brighter than white is white.
    """
    radiance, around = np.zeros((HEIGHT, WIDTH, 3)), False
    for single in leaves(light):
        match single:
            case Unknown():
                return None
            case Environment():
                radiance, around = radiance + resize(single, HEIGHT, WIDTH).radiance, True
            case Directional():
                radiance += _disc(single.direction) * (single.irradiance / _DISC)
            case Point():
                if centre is None:
                    return None
                away = single.position - centre
                distance = max(float(np.linalg.norm(away)), 1e-6)
                radiance += _disc(away / distance) * (single.intensity / distance**2 / _DISC)
            case _:
                assert_never(single)
    level = np.quantile(radiance.max(axis=-1), _BRIGHT) / _SHOWN if around else radiance.max()
    return np.maximum(srgb(radiance / max(float(level), 1e-12)), _NIGHT)


def light_pictures(frames: Iterable[Frame]) -> Iterator[tuple[str, bytes]]:
    """Names and PNG files: one of a lighting, under its name, or one a frame, under its key, where frames of a lighting
    are lit otherwise. Frames whose light or place is not known, or whose pose cannot be read, have none."""
    drawn: dict[tuple[int, str], bytes | None] = {}
    found: dict[str, dict[str, bytes]] = {}
    for frame in frames:
        near = any(isinstance(leaf, Point) for leaf in leaves(frame.light))  # it looks otherwise from another place
        seen = id(frame.light), frame.pose_key if near else ""
        if seen not in drawn:
            drawn[seen] = _drawn(frame)
        if (content := drawn[seen]) is not None:
            found.setdefault(frame.lighting, {})[frame.key] = content
    for lighting, of_frames in found.items():
        if len(set(of_frames.values())) == 1:
            yield lighting, next(iter(of_frames.values()))
        else:
            yield from of_frames.items()


def _drawn(frame: Frame) -> bytes | None:
    import io

    from PIL import Image

    try:
        picture = panorama(frame.light, _place(frame))
    except HandbenchError:
        return None
    if picture is None:
        return None
    out = io.BytesIO()
    Image.fromarray(np.round(255 * picture).astype(np.uint8)).save(out, "PNG", optimize=True)
    return out.getvalue()


def _place(frame: Frame) -> Array | None:
    """Where the hand is, (3,) in the world, if its frame tells."""
    if frame.pose is not None:
        return frame.pose.translation
    return None if frame.mesh is None else frame.mesh.vertices.mean(axis=0)


def _disc(direction: Array) -> Array:
    """Where a lamp is, (HEIGHT, WIDTH, 1) with a soft rim."""
    angle = np.arccos(np.clip(directions(HEIGHT, WIDTH) @ direction, -1.0, 1.0))
    return np.clip((_RADIUS - angle) / (0.25 * _RADIUS) + 0.5, 0.0, 1.0)[..., None]
