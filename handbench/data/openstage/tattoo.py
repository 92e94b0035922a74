"""Tattoos drawn by formula on the back of the hand: coverage of ink at points of a disc."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...errors import unknown_name
from ...scene import Array

_LINE = 0.035


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


TATTOOS: dict[str, Callable[[Array, Array], Array]] = {"star": _star, "mandala": _mandala, "anchor": _anchor}
