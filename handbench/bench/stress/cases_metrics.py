"""Every registered metric on equal, damaged, tiny, huge and empty images."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from functools import partial

import numpy as np

from ...errors import InputError, Unsupported
from ...registry import METRICS
from ...scene import Array
from .case import Case
from .outcome import Compared, accurate, equal, finite, finite_or, refused

FAMILY = "metrics"
SIZE = 40


BEST = {"psnr": 100.0, "ssim": 1.0, "lpips-alex": 0.0, "lpips-vgg": 0.0}
"""Of equal images."""


def cases() -> Iterator[Case]:
    for name in METRICS.entries():
        for label, prediction in _predictions().items():
            yield Case(FAMILY, f"{name}, {label}", finite(), partial(_score, name, prediction))
        for label, prediction in _damaged().items():
            yield Case(FAMILY, f"{name}, {label}", refused(Unsupported), partial(_score, name, prediction))
        for label, mask in _masks().items():
            yield Case(FAMILY, f"{name}, {label}", finite_or(Unsupported), partial(_score, name, image(), mask))
        yield Case(FAMILY, f"{name}, image of one pixel", finite_or(Unsupported), partial(_tiny, name))
        for label, inputs in _broken().items():
            yield Case(FAMILY, f"{name}, {label}", refused(InputError), partial(_pair_score, name, *inputs))
        if name in BEST:
            yield Case(FAMILY, f"{name}, equal images", equal(1e-6), partial(_perfect, name), "the best value")
            empty = partial(_score, f"{name}:region=box", image(), np.zeros((SIZE, SIZE)))
            yield Case(FAMILY, f"{name}, empty mask", refused(Unsupported), empty)
            scaled = partial(_score, f"{name}:scale=rgb", 1e-8 * image())
            yield Case(FAMILY, f"{name}, scaled up from 1e-8", finite(), scaled)
            black = partial(_score, f"{name}:scale=rgb", 0.0 * image())
            yield Case(FAMILY, f"{name}, nothing to scale", finite(), black)
    yield Case(FAMILY, "psnr of a small error", accurate(1e-9), partial(_psnr, 1e-4), "numpy float64")
    yield Case(FAMILY, "psnr of radiance 1e8", accurate(1e-9), partial(_psnr, 1e8), "numpy float64")
    yield Case(FAMILY, "psnr, scale found again", equal(1e-5), _scale, "the cap")


def image() -> Array:
    """A smooth picture in [0, 1], float32."""
    y, x = np.mgrid[:SIZE, :SIZE] / SIZE
    return np.stack([x, y, 0.5 + 0.5 * np.sin(9 * x * y)], axis=-1).astype(np.float32)


def _predictions() -> dict[str, Array]:
    hot = image().copy()
    hot[20, 20] = 1e8
    return {
        "black prediction": 0.0 * image(),
        "prediction of 1e8": np.full_like(image(), 1e8),
        "one hot pixel": hot,
        "negative prediction": -image(),
        "half precision": image().astype(np.float16),
        "greatest float32": np.full_like(image(), np.finfo(np.float32).max),
    }


def _damaged() -> dict[str, Array]:
    nan, infinite = image().copy(), image().copy()
    nan[3, 4, 1], infinite[3, 4, 1] = np.nan, np.inf
    return {"prediction with NaN": nan, "prediction with infinity": infinite}


def _masks() -> dict[str, Array]:
    one, corner = np.zeros((SIZE, SIZE)), np.zeros((SIZE, SIZE))
    one[17, 23] = corner[0, 0] = 1.0
    return {"mask of one pixel": one, "mask of one pixel in the corner": corner, "half-covered mask": one * 0 + 0.5}


def _broken() -> dict[str, tuple[Array, Array, Array]]:
    ones = np.ones((SIZE, SIZE))
    nan = image().copy()
    nan[3, 4, 1] = np.nan
    return {
        "truth with NaN": (image(), nan, ones),
        "mask with NaN": (image(), image(), ones * np.nan),
        "prediction of another size": (image()[:-1], image(), ones),
        "display codes": ((255 * image()).astype(np.uint8), image(), ones),
        "images without pixels": (image()[:0], image()[:0], ones[:0]),
    }


def _pair_score(name: str, prediction: Array, truth: Array, mask: Array) -> float:
    """The value; a score without one raises its reason, as the error that a method would raise."""
    metrics = importlib.import_module(METRICS.package)
    (score,) = metrics.metric(name)([metrics.Pair(prediction, truth, mask)])
    if score.value is None:
        raise Unsupported(score.reason)
    return float(score.value)


def _score(name: str, prediction: Array, mask: Array | None = None) -> float:
    return _pair_score(name, prediction, image(), np.ones((SIZE, SIZE)) if mask is None else mask)


def _perfect(name: str) -> Compared:
    return Compared(_score(name, image()), BEST[name], least=1.0)


def _tiny(name: str) -> float:
    one = np.full((1, 1, 3), 0.5)
    return _pair_score(name, one, one, np.ones((1, 1)))


def _psnr(off: float) -> Compared:
    prediction = image().astype(np.float64) + off
    value = _pair_score("psnr:space=linear", prediction, image(), np.ones((SIZE, SIZE)))
    return Compared(value, -20 * np.log10(off), least=1.0)


def _scale() -> Compared:
    return Compared(_score("psnr:scale=scalar", 1e-6 * image().astype(np.float64)), 100.0)
