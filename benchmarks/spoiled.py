"""Pictures of a hand with which something is wrong, as users bring them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from handbench.hand.fitting import HandPicture
from handbench.scene import Array, Camera

Spoil: TypeAlias = Callable[[HandPicture, np.random.Generator], HandPicture]


def in_a_mirror(picture: HandPicture) -> HandPicture:
    """The picture, its key points and its camera mirrored: the other hand. The pose goes: it is of no left hand."""
    camera = picture.camera
    K = np.array(camera.K)
    K[0, 2] = camera.width - K[0, 2]
    return replace(
        picture,
        camera=replace(camera, K=K),
        key_points=np.array([camera.width, 0]) + np.array([-1, 1]) * picture.key_points,
        alpha=None if picture.alpha is None else picture.alpha[:, ::-1],
        depth=None if picture.depth is None else picture.depth[:, ::-1],
        start=None,
    )


def zoomed(camera: Camera, factor: float) -> Camera:
    """The camera with another focal length."""
    return replace(camera, K=camera.K * np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]]))


def and_another(picture: HandPicture, shift: float) -> HandPicture:
    """The picture with a copy of its mask beside it, shifted by a share of the mask's own width."""
    if picture.alpha is None:
        return picture
    columns = np.flatnonzero((picture.alpha > 0.5).any(axis=0))
    left = columns.mean() > picture.camera.width / 2
    away = round(shift * (columns[-1] - columns[0] + 1)) * (-1 if left else 1)
    return replace(picture, alpha=np.maximum(picture.alpha, _shifted(picture.alpha, away)))


def _shifted(alpha: Array, columns: int) -> Array:
    other = np.zeros_like(alpha)
    if columns > 0:
        other[:, columns:] = alpha[:, :-columns]
    else:
        other[:, :columns] = alpha[:, -columns:]
    return other


def another_thing(picture: HandPicture, rng: np.random.Generator) -> HandPicture:
    """A disc where the hand was, and in it the key points of a detector that sees hands everywhere."""
    camera, points = picture.camera, picture.key_points
    middle, size = np.nanmean(points, axis=0), np.nanstd(points, axis=0).max()
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    disc = np.hypot(columns - middle[0], rows - middle[1]) < 1.8 * size
    depth = None if picture.depth is None else np.where(disc, np.median(picture.depth[picture.depth > 0]), 0.0)
    guessed = middle + rng.normal(0.0, 0.9 * size, (21, 2))
    return replace(picture, alpha=disc.astype(np.float32), depth=depth, key_points=guessed)


def cut(picture: HandPicture, share: float) -> HandPicture:
    """The picture without that share of the key points' height, from above: nothing is seen beyond its new edge."""
    camera, points = picture.camera, picture.key_points
    low, high = np.nanmin(points[:, 1]), np.nanmax(points[:, 1])
    edge = int(low + share * (high - low))
    K = camera.K.copy()
    K[1, 2] -= edge
    return replace(
        picture,
        camera=replace(camera, K=K, height=camera.height - edge),
        key_points=np.where(points[:, 1:] < edge, np.nan, points - [0, edge]),
        alpha=None if picture.alpha is None else picture.alpha[edge:],
        depth=None if picture.depth is None else picture.depth[edge:],
    )


def _without_key_points(picture: HandPicture, rng: np.random.Generator) -> HandPicture:
    return replace(picture, key_points=np.full((21, 2), np.nan))


def _masked(picture: HandPicture, value: float) -> HandPicture:
    return replace(picture, alpha=np.full((picture.camera.height, picture.camera.width), value, np.float32))


def _millimetres(picture: HandPicture, rng: np.random.Generator) -> HandPicture:
    return replace(picture, depth=None if picture.depth is None else 1000 * picture.depth)


SPOILS: dict[str, Spoil] = {
    "nothing": lambda picture, rng: picture,
    "no key points": _without_key_points,
    "an empty mask": lambda picture, rng: _masked(picture, 0.0),
    "a mask of everything": lambda picture, rng: _masked(picture, 1.0),
    "a quarter cut by the edge": lambda picture, rng: cut(picture, 0.25),
    "half cut by the edge": lambda picture, rng: cut(picture, 0.5),
    "a left hand": lambda picture, rng: in_a_mirror(picture),
    "no hand: another thing": another_thing,
    "key points shuffled": lambda picture, rng: replace(picture, key_points=rng.permutation(picture.key_points)),
    "depth in millimetres": _millimetres,
    "half the focal length": lambda picture, rng: replace(picture, camera=zoomed(picture.camera, 0.5)),
    "twice the focal length": lambda picture, rng: replace(picture, camera=zoomed(picture.camera, 2.0)),
    "a second hand, apart": lambda picture, rng: and_another(picture, 1.15),
    "a second hand, touching": lambda picture, rng: and_another(picture, 0.7),
}
"""What can be wrong, by the name of it."""
