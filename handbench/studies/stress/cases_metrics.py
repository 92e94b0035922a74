"""Every registered metric of pictures on equal, damaged, tiny, huge and empty images."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from ...errors import InputError, Unsupported
from ...registry import METRICS
from ...scene import Array
from .case import Case
from .judgement import TruthPair, accurate, equal, finite, finite_or, refused

FAMILY = "metrics"
SIZE = 40
LARGE = 176
"""For metrics that do not say how large a picture they need."""


def cases() -> Iterator[Case]:
    for name in filter(_of_pictures, METRICS.entries()):
        yield from _of(name)
    yield Case(FAMILY, "psnr of a small error", accurate(1e-9), partial(_psnr, 1e-4), "numpy float64")
    yield Case(FAMILY, "psnr of radiance 1e8", accurate(1e-9), partial(_psnr, 1e8), "numpy float64")
    yield Case(FAMILY, "psnr, scale found again", equal(1e-5), _scale, "the cap")


def _family(name: str) -> Any:
    try:
        return METRICS.load(name)
    except InputError:
        return None  # a broken plug-in: its cases say so


def _of_pictures(name: str) -> bool:
    """Whether a metric looks at the pictures of a pair and at nothing else."""
    return set(getattr(_family(name), "needs", ())) <= {"prediction", "truth"}


def _of(name: str) -> Iterator[Case]:
    """Cases of a metric, on pictures as large as it needs."""
    family = _family(name)
    size = max(SIZE, getattr(family, "least", LARGE))
    picture, ones = image(size), np.ones((size, size))
    defined = finite() if hasattr(family, "least") else finite_or(Unsupported)  # others may have rules of their own
    for label, prediction in _predictions(picture).items():
        yield Case(FAMILY, f"{name}, {label}", defined, partial(_score, name, prediction, picture, ones))
    for label, prediction in _damaged(picture).items():
        yield Case(FAMILY, f"{name}, {label}", refused(Unsupported), partial(_score, name, prediction, picture, ones))
    for label, mask in _masks(size).items():
        yield Case(FAMILY, f"{name}, {label}", finite_or(Unsupported), partial(_score, name, picture, picture, mask))
    yield Case(FAMILY, f"{name}, image of one pixel", finite_or(Unsupported), partial(_tiny, name))
    for label, inputs in _broken(picture).items():
        yield Case(FAMILY, f"{name}, {label}", refused(InputError), partial(_score, name, *inputs))
    perfect = getattr(family, "perfect", None)
    if perfect is not None:
        best = partial(_equal, name, picture, perfect)
        yield Case(FAMILY, f"{name}, equal images", equal(1e-6), best, "the best value")
    if "scale" in getattr(family, "options", ()):
        for label, prediction, mask, expected in (
            ("empty mask", picture, 0 * ones, refused(Unsupported)),
            ("scaled up from 1e-8", 1e-8 * picture, ones, finite()),
            ("nothing to scale", 0.0 * picture, ones, finite()),
        ):
            run = partial(_score, f"{name}:scale=rgb", prediction, picture, mask)
            yield Case(FAMILY, f"{name}, {label}", expected, run)


def image(size: int = SIZE) -> Array:
    """A smooth picture in [0, 1], float32."""
    y, x = np.mgrid[:size, :size] / size
    return np.stack([x, y, 0.5 + 0.5 * np.sin(9 * x * y)], axis=-1).astype(np.float32)


def _predictions(picture: Array) -> dict[str, Array]:
    hot = picture.copy()
    hot[20, 20] = 1e8
    return {
        "black prediction": 0.0 * picture,
        "prediction of 1e8": np.full_like(picture, 1e8),
        "one hot pixel": hot,
        "negative prediction": -picture,
        "half precision": picture.astype(np.float16),
        "greatest float32": np.full_like(picture, np.finfo(np.float32).max),
    }


def _damaged(picture: Array) -> dict[str, Array]:
    nan, infinite = picture.copy(), picture.copy()
    nan[3, 4, 1], infinite[3, 4, 1] = np.nan, np.inf
    return {"prediction with NaN": nan, "prediction with infinity": infinite}


def _masks(size: int) -> dict[str, Array]:
    one, corner = np.zeros((size, size)), np.zeros((size, size))
    one[17, 23] = corner[0, 0] = 1.0
    return {"mask of one pixel": one, "mask of one pixel in the corner": corner, "half-covered mask": one * 0 + 0.5}


def _broken(picture: Array) -> dict[str, tuple[Array, Array, Array]]:
    ones, nan = np.ones(picture.shape[:2]), picture.copy()
    nan[3, 4, 1] = np.nan
    return {
        "truth with NaN": (picture, nan, ones),
        "mask with NaN": (picture, picture, ones * np.nan),
        "prediction of another size": (picture[:-1], picture, ones),
        "display codes": ((255 * picture).astype(np.uint8), picture, ones),
        "images without pixels": (picture[:0], picture[:0], ones[:0]),
    }


def _score(name: str, prediction: Array, truth: Array, mask: Array) -> float:
    """The value; a score without one raises its reason, as the error that a method would raise."""
    from ... import metrics

    (score,) = metrics.metric(name)([metrics.Pair(prediction, truth, mask)])
    if score.value is None:
        raise Unsupported(score.reason)
    return float(score.value)


def _equal(name: str, picture: Array, perfect: float) -> TruthPair:
    return TruthPair(_score(name, picture, picture, np.ones(picture.shape[:2])), perfect, least=1.0)


def _tiny(name: str) -> float:
    one = np.full((1, 1, 3), 0.5)
    return _score(name, one, one, np.ones((1, 1)))


def _psnr(off: float) -> TruthPair:
    prediction = image().astype(np.float64) + off
    return TruthPair(
        _score("psnr:space=linear", prediction, image(), np.ones((SIZE, SIZE))), -20 * np.log10(off), least=1.0
    )


def _scale() -> TruthPair:
    prediction = 1e-6 * image().astype(np.float64)
    return TruthPair(_score("psnr:scale=scalar", prediction, image(), np.ones((SIZE, SIZE))), 100.0)
