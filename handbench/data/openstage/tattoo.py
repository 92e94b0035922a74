"""Tattoos drawn by formula on the back of the hand or the forearm: coverage of ink at points of a disc."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...errors import unknown_name
from ...scene import Array
from .places import Places, smoothstep

_LINE = 0.035


@dataclass(frozen=True)
class Tattoo:
    """name: one of `TATTOOS`. x, y: its middle on the neutral hand (thumb side, finger tips) and radius, in metres;
    turn: radians, counter-clockwise as one looks at the back of the hand."""

    name: str
    x: float = -0.001
    y: float = 0.052
    radius: float = 0.017
    turn: float = 0.0


def inked(at: Places, tattoos: tuple[Tattoo, ...]) -> Array:
    """Coverage (N,) of ink in [0, 1] per texel. `InputError` for unknown names."""
    total = np.zeros(len(at.position), np.float32)
    for one in tattoos:
        x, y = (one.x - at.position[:, 0]) / one.radius, (at.position[:, 1] - one.y) / one.radius
        on = np.flatnonzero((np.hypot(x, y) < 1.5) & (at.facing < -0.1) & (at.finger < 0))
        sine, cosine = np.sin(one.turn), np.cos(one.turn)
        x, y = cosine * x[on] + sine * y[on], cosine * y[on] - sine * x[on]
        drawn = tattoo(one.name, x, y) * smoothstep(-0.1, -0.35, at.facing[on])
        total[on] = np.maximum(total[on], drawn)
    return total


def tattoo(name: str, x: Array, y: Array) -> Array:
    """Coverage (N,) of ink in [0, 1] at points in units of the drawing's radius. `InputError` for unknown names."""
    if name not in TATTOOS:
        raise unknown_name("tattoo", name, TATTOOS)
    return TATTOOS[name](x, y)


def _ink(distance: Array, line: float = _LINE) -> Array:
    """A pen stroke: full within half a line of distance 0, soft at its edge."""
    return np.clip((line - np.abs(distance)) / (0.5 * line) + 0.5, 0, 1)


def _star(x: Array, y: Array) -> Array:
    """A nautical star: five points whose right halves are filled."""
    radius, angle = np.hypot(x, y), np.arctan2(x, y)
    turn = (angle + np.pi / 5) % (2 * np.pi / 5) - np.pi / 5
    tip, dent = np.array([1.0, 0.0]), 0.4 * np.array([np.cos(np.pi / 5), np.sin(np.pi / 5)])
    px, py = radius * np.cos(turn), radius * np.abs(np.sin(turn))
    edge = dent - tip
    inward = (edge[0] * (py - tip[1]) - edge[1] * (px - tip[0])) / np.hypot(*edge)
    fold = radius * np.sin(turn)
    inside = inward > 0
    outline = _ink(inward)
    filled = np.clip(fold / _LINE + 0.5, 0, 1) * inside
    return np.maximum(outline * (radius < 1.1), 0.9 * filled)


def _mandala(x: Array, y: Array) -> Array:
    """Rings of petals and dots."""
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    rings = [_ink(radius - r, w) for r, w in ((0.16, 0.03), (0.5, 0.025), (0.56, 0.02), (0.97, 0.035))]
    inner = _ink(radius - (0.18 + 0.28 * np.abs(np.cos(4 * angle)) ** 0.7), 0.03)
    outer = _ink(radius - (0.6 + 0.3 * np.abs(np.cos(6 * angle + np.pi / 2)) ** 0.6), 0.03)
    turn = (angle + np.pi / 12) % (np.pi / 6) - np.pi / 12
    dots = np.clip((0.05 - np.hypot(radius - 0.74, 0.74 * turn)) / 0.015 + 0.5, 0, 1)
    core = np.clip((0.08 - radius) / 0.015 + 0.5, 0, 1)
    return np.maximum.reduce([*rings, inner, outer, dots, core]) * (radius < 1.05)


def _anchor(x: Array, y: Array) -> Array:
    """An anchor: ring, shank, stock, arms and flukes."""
    ring = _ink(np.hypot(x, y - 0.78) - 0.15, 0.05)
    shank = _ink(x, 0.06) * (y < 0.64) * (y > -0.85)
    stock = _ink(y - 0.42, 0.055) * (np.abs(x) < 0.38)
    radius, angle = np.hypot(x, y + 0.15), np.arctan2(np.abs(x), -(y + 0.15))
    arms = _ink(radius - 0.68, 0.065) * (angle < 1.25)
    flukes = np.clip((0.2 - np.abs(np.abs(x) - 0.62) - 0.8 * np.abs(y - 0.02)) / 0.03, 0, 1)
    return np.maximum.reduce([ring, shank, stock, arms, flukes])


def _rose(x: Array, y: Array) -> Array:
    """A rose from above: petals that wind outwards, shaded at their rims."""
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    total = np.zeros_like(radius)
    for k, size in enumerate((0.2, 0.38, 0.58, 0.8, 1.0)):
        petals = 3 + (k > 1) + (k > 3)
        wave = size * (0.82 + 0.18 * np.abs(np.cos(petals * angle / 2 + 1.3 * k)))
        total = np.maximum(total, _ink(radius - wave, 0.03))
        shade = np.clip(1 - (wave - radius) / 0.12, 0, 1) * (radius < wave)
        total = np.maximum(total, 0.55 * shade * (0.5 + 0.5 * np.cos(petals * angle + k)))
    return np.maximum(total, _ink(radius - 0.08 - 0.02 * angle, 0.03) * (radius < 0.2))


def _serpent(x: Array, y: Array) -> Array:
    """A snake that winds upwards, with bands across and a head."""
    way = 0.42 * np.sin(3.6 * y) * (1 - 0.25 * y)
    thick = 0.17 * np.clip(1.05 + y, 0.05, 1) ** 0.6 * (1 - 0.5 * np.clip((y - 0.5) / 0.3, 0, 1))
    away = (x - way) / np.sqrt(1 + (1.3 * np.cos(3.6 * y)) ** 2)
    body = (y > -1) & (y < 0.8)
    scales = 0.8 * (np.sin(26 * y + 9 * np.abs(away)) > 0.15) * (np.abs(away) < thick)
    head = np.hypot((x - 0.05) / 0.9, (y - 0.88) / 1.25) - 0.15
    total = np.maximum(_ink(np.abs(away) - thick, 0.03), scales) * body
    return np.maximum.reduce([total, _ink(head, 0.04), 0.7 * np.clip(-head / 0.04, 0, 1)])


def _compass(x: Array, y: Array) -> Array:
    """A compass rose: four long and four short points, half of each filled, in a ring with marks."""
    radius, angle = np.hypot(x, y), np.arctan2(x, y)
    total = _ink(radius - 0.72, 0.025)
    for tip, dent, turn in ((0.62, 0.2, np.pi / 4), (1.0, 0.22, 0.0)):
        a = (angle + turn + np.pi / 4) % (np.pi / 2) - np.pi / 4
        px, py = radius * np.cos(a), radius * np.abs(np.sin(a))
        inside = (tip - px) * dent * 0.71 - py * (tip - dent * 0.71)
        total = np.where(inside > 0, 0.9 * np.clip(a * radius / 0.02 + 0.5, 0, 1), total)
        total = np.maximum(total, _ink(inside / tip, 0.03) * (radius < tip + 0.05))
    marks = _ink(radius - 0.8, 0.05) * (np.cos(32 * angle) > 0.6)
    return np.maximum(total, marks)


def _moon(x: Array, y: Array) -> Array:
    """A crescent with stippled shade and small stars."""
    outer, inner = np.hypot(x, y) - 0.85, np.hypot(x - 0.34, y - 0.1) - 0.68
    crescent = np.maximum(outer, -inner)
    stipple = (np.sin(41 * x + 13 * y) * np.sin(37 * y - 17 * x) > 0.1 - 0.6 * x) * (crescent < 0)
    total = np.maximum(_ink(crescent, 0.04), 0.8 * stipple)
    for sx, sy, size in ((0.3, 0.15, 0.24), (0.62, -0.2, 0.14), (0.5, 0.5, 0.12)):
        radius, angle = np.hypot(x - sx, y - sy), np.arctan2(y - sy, x - sx)
        total = np.maximum(
            total, np.clip((size * (0.25 + 0.75 * np.abs(np.cos(2 * angle)) ** 6) - radius) / 0.02, 0, 1)
        )
    return total


def _waves(x: Array, y: Array) -> Array:
    """Rows of waves whose crests curl."""
    total = np.zeros_like(x)
    for row in range(-3, 4):
        base = 0.28 * row
        crest = base + 0.13 * np.abs(np.sin(4.2 * x + 1.6 * row)) ** 0.7
        total = np.maximum(total, _ink(y - crest, 0.035))
        foam = np.sin(40 * (crest - y)) > 0.4
        total = np.maximum(total, 0.75 * foam * (y < crest) * (y > crest - 0.12))
    return total * (np.hypot(x, y) < 1.0)


def _lotus(x: Array, y: Array) -> Array:
    """A lotus: pointed petals in two rows over lines of water."""
    total = np.zeros_like(x)
    for turn, size in ((-1.25, 0.8), (1.25, 0.8), (-0.75, 0.95), (0.75, 0.95), (-0.35, 1.05), (0.35, 1.05), (0, 1.15)):
        u = x * np.cos(turn) - (y + 0.45) * np.sin(turn)
        v = (x * np.sin(turn) + (y + 0.45) * np.cos(turn)) / size
        half = 0.21 * np.sin(np.pi * np.clip(v, 0, 1) ** 0.8)
        inside = (v > 0) & (v < 1) & (np.abs(u) < half)
        total = np.where(inside, 0.6 * np.clip(1 - 2.2 * v, 0, 1), total)
        total = np.maximum(total, _ink(np.abs(u) - half, 0.03) * (v > 0) * (v < 1))
    for k, width in enumerate((0.9, 0.65, 0.4)):
        total = np.maximum(total, _ink(y + 0.6 + 0.13 * k, 0.03) * (np.abs(x) < width))
    return total


def _tribal(x: Array, y: Array) -> Array:
    """Black blades that curve around each other."""
    total = np.zeros_like(x)
    for k in range(5):
        turn = 2 * np.pi * k / 5
        u, v = x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)
        curve = 0.55 * np.sin(2.1 * v)
        thick = 0.17 * np.clip(1.0 - v, 0, 1) ** 0.7 * (v > 0.05)
        total = np.maximum(total, np.clip((thick - np.abs(u - curve)) / 0.02 + 0.5, 0, 1) * (thick > 0))
    return total


def _bands(x: Array, y: Array) -> Array:
    """Bands across, as worn around an arm: solid, zigzag and dots."""
    zigzag = np.abs((2.2 * x) % 1 - 0.5)
    solid = np.clip((0.16 - np.abs(y - 0.62)) / 0.02, 0, 1) + np.clip((0.1 - np.abs(y + 0.7)) / 0.02, 0, 1)
    teeth = np.clip((0.15 + 0.4 * zigzag - np.abs(y)) / 0.02, 0, 1) * np.clip((np.abs(y) - 0.3 * zigzag) / 0.02, 0, 1)
    dots = np.clip((0.06 - np.hypot((4.4 * x % 1 - 0.5) / 4.4, y + 0.42)) / 0.02, 0, 1)
    return np.clip(solid + teeth + dots, 0, 1)


TATTOOS: dict[str, Callable[[Array, Array], Array]] = {
    "star": _star,
    "mandala": _mandala,
    "anchor": _anchor,
    "compass": _compass,
    "moon": _moon,
    "waves": _waves,
    "tribal": _tribal,
    "bands": _bands,
    "rose": _rose,
    "serpent": _serpent,
    "lotus": _lotus,
}
# Never on anybody that a method may train on: for subjects whose tattoos are new to it.
HELD_OUT = ("rose", "serpent", "lotus")
