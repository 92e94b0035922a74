"""What several official evaluators need: masks, pictures over white, PSNR, SSIM and LPIPS of given arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial, wraps
from types import MappingProxyType
from typing import TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import interpolate

from handbench.errors import Unsupported
from handbench.scene.colour import srgb

from ..base import PairFamily
from ..networks import STAGES, features, network_weights, strides
from ..pair import Pair
from ..tiles import tiles

CAP = 100.0
CAPPED = f"cap:{CAP:g}"
# Some evaluators look where the prediction is; where a prediction states no alpha, it is taken to be the truth's.
COVERAGE = "coverage:own-else-truth"

_LEAST = {"alex": 32, "vgg": 16}  # pixels a side: below, the deepest layer has none left

_NONE: Mapping[str, tuple[str, ...]] = MappingProxyType({})

T = TypeVar("T")


def family(
    evaluator: str,
    measure: Callable[..., float],
    quantity: str,
    terms: tuple[str, ...],
    *,
    name: str | None = None,
    choices: Mapping[str, tuple[str, ...]] = _NONE,
    needs: tuple[str, ...] = ("prediction",),
    perfect: float | None = None,
    unit: str = "",
    decimals: int = 4,
    higher_is_better: bool = True,
    version: int = 1,
) -> PairFamily:
    """The metric `evaluator`-`name`; its name is the quantity's unless given. `measure` gets the choices by name."""

    def measured(pair: Pair, options: Mapping[str, str]) -> float:
        return measure(pair, **options)

    return PairFamily(
        f"{evaluator}-{name or quantity.lower()}",
        f"{quantity} ({evaluator})",
        measured,
        higher_is_better=higher_is_better,
        unit=unit,
        decimals=decimals,
        terms=terms,
        perfect=perfect,
        choices=choices,
        needs=needs,
        version=version,
    )


psnr_family = partial(family, quantity="PSNR", unit="dB", decimals=2)
lpips_family = partial(family, quantity="LPIPS", higher_is_better=False)


def per_pair(prepare: Callable[[Pair], T]) -> Callable[[Pair], T]:
    """Prepare a pair once for all metrics of an evaluator; forgotten with the pair."""
    kept: WeakKeyDictionary[Pair, T] = WeakKeyDictionary()

    @wraps(prepare)
    def prepared(pair: Pair) -> T:
        if pair not in kept:
            kept[pair] = prepare(pair)
        return kept[pair]

    return prepared


def some(mask: NDArray[np.bool_], what: str) -> NDArray[np.bool_]:
    """The mask (H, W), if it has a pixel; `Unsupported` says what it lacks."""
    if not mask.any():
        raise Unsupported(f"empty mask: no pixel {what}")
    return mask


def own_alpha(pair: Pair) -> NDArray[np.float64]:
    """Alpha (H, W) of the prediction, the truth's where the prediction states none."""
    alpha = pair.mask if pair.prediction_alpha is None else pair.prediction_alpha
    if not np.isfinite(alpha).all():
        raise Unsupported("non-finite prediction alpha")
    return alpha.astype(np.float64)


def display(image: NDArray[np.floating], alpha: NDArray[np.floating] | None = None) -> NDArray[np.float64]:
    """A premultiplied linear image (H, W, 3), over white if its alpha (H, W) is given, sRGB encoded, in [0, 1]."""
    linear = image.astype(np.float64)
    return srgb(linear if alpha is None else linear + (1.0 - np.clip(alpha, 0.0, 1.0))[..., None])


def eight_bit(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values in [0, 1], rounded to what a picture of 8 bits a channel can hold."""
    return np.round(np.clip(image, 0.0, 1.0) * 255.0) / 255.0


def decibel(error: float, peak: float = 1.0) -> float:
    """PSNR of a mean squared error. Official code says infinity for none; a result file cannot hold that."""
    return CAP if error <= 0.0 else min(CAP, float(10.0 * np.log10(peak**2 / error)))


def ssim_map(
    one: NDArray[np.float64], other: NDArray[np.float64], blur: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> NDArray[np.float64]:
    """SSIM (Wang et al. 2004, Eq. 13) of each pixel and channel, data range 1, windows as `blur` averages."""
    a, b = blur(one), blur(other)
    va, vb, covariance = blur(one * one) - a * a, blur(other * other) - b * b, blur(one * other) - a * b
    return ((2 * a * b + 1e-4) * (2 * covariance + 9e-4)) / ((a * a + b * b + 1e-4) * (va + vb + 9e-4))


def lpips(network: str, one: NDArray[np.floating], other: NDArray[np.floating]) -> float:
    """LPIPS v0.1 of two images (H, W, 3) in the range that the networks expect, [-1, 1], or whatever was fed to them.

    Raises `Unsupported` for images that are too small for the network.
    """
    return sum(float(layer.mean()) for layer in _distances(network, one, other))


def lpips_map(network: str, one: NDArray[np.floating], other: NDArray[np.floating]) -> NDArray[np.float32]:
    """LPIPS v0.1 in each pixel (H, W): the layers' maps, enlarged bilinearly and added, as `LPIPS(spatial=True)`."""
    size = one.shape[:2]
    layers = (
        interpolate(layer[None, None], size=size, mode="bilinear", align_corners=False)[0, 0]
        for layer in _distances(network, one, other)
    )
    found: NDArray[np.float32] = sum(layers, torch.zeros(size)).numpy()
    return found


def _distances(network: str, one: NDArray[np.floating], other: NDArray[np.floating]) -> list[Tensor]:
    """Of every layer the weighted squared differences of unit features, (h, w)."""
    if min(one.shape[:2]) < _LEAST[network]:
        raise Unsupported(
            f"picture of {one.shape[0]}x{one.shape[1]} pixels is smaller than the {_LEAST[network]} that LPIPS needs"
        )
    heads = [network_weights(f"lpips_{network}")[f"head{i}.weight"] for i in range(len(STAGES[network]))]
    rows: list[list[list[Tensor]]] = [[] for _ in heads]  # by layer: rows of tiles
    with torch.no_grad():
        for tile in tiles(*one.shape[:2]):
            # `features` maps [0, 1] to [-1, 1] itself
            cut = np.stack([one[tile.cut], other[tile.cut]]).astype(np.float32)
            layers = features(network, (torch.from_numpy(cut).permute(0, 3, 1, 2) + 1.0) / 2.0)
            for row, layer, stride, head in zip(rows, layers, strides(network), heads, strict=True):
                f = layer[:, :, *tile.features(stride)]
                unit = f / (torch.linalg.vector_norm(f, dim=1, keepdim=True) + 1e-10)
                if tile.own[1].start == 0:
                    row.append([])
                row[-1].append(torch.einsum("chw,c->hw", (unit[0] - unit[1]) ** 2, head))
    return [torch.cat([torch.cat(of_row, 1) for of_row in row]) for row in rows]
