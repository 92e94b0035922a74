"""Two pictures from anywhere made comparable: one mask, both on black, and what a reader must know of them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..scene import Array
from .pictures import Picture

_BLACK = 6e-4  # linear: two of 255 display codes, which JPEG and dithering leave
_SOME = 0.01  # share of pixels that is no accident


@dataclass(frozen=True, eq=False)
class Compared:
    """Prediction and truth (H, W, 3), linear, premultiplied, the mask (H, W), and remarks by kind."""

    prediction: Array
    truth: Array
    mask: Array
    prediction_alpha: Array | None
    remarks: dict[str, str] = field(default_factory=dict)


def compared(prediction: Picture, truth: Picture, mask: Array | None = None) -> Compared:
    """Both pictures, of one size, on black, under the mask that is given, the truth's alpha, or everywhere.

    With a mask, what a picture without alpha shows outside of it (and of the truth's alpha) is made black, on both
    sides alike: a photograph becomes what an alpha channel would have made it.
    """
    remarks: dict[str, str] = {}
    image, seen = prediction.image, truth.image
    if mask is not None:
        outline = mask if truth.alpha is None else np.maximum(mask, truth.alpha)
        if truth.alpha is None:
            seen = _on_black(seen, outline)
        if prediction.alpha is None:
            image = _on_black(image, outline)
            if image is not prediction.image:
                remarks["background"] = "the prediction is not black outside the mask: what it shows there is left out"
    elif truth.alpha is not None:
        mask = truth.alpha
        if prediction.alpha is None and _shows(image, mask == 0) > _SOME:
            remarks["background"] = (
                "the prediction has no alpha and is not black outside the truth's: it pays for that where a metric "
                "looks there; --mask leaves it out"
            )
    else:
        mask = np.ones(seen.shape[:2], np.float32)
        remarks["mask"] = "the truth has no alpha and no mask is given: the whole picture counts as the hand"
    if prediction.alpha is None:
        remarks["alpha"] = "the prediction has no alpha: where an evaluator looks at it, the truth's is taken"
    for what, picture in (("prediction", prediction), ("truth", truth)):
        remarks |= _odd(what, picture, mask)
    return Compared(image, seen, mask, prediction.alpha, remarks)


def _on_black(image: Array, outline: Array) -> Array:
    """The same image if it is black outside already, else the image times the outline."""
    return image * outline[..., None] if _shows(image, outline == 0) else image


def _shows(image: Array, where: Array) -> float:
    """The share of the pixels (H, W) of `where` that are not black; 0 if there are none."""
    return float((np.abs(image[where]).max(axis=-1) > _BLACK).mean()) if where.any() else 0.0


def _odd(what: str, picture: Picture, mask: Array) -> dict[str, str]:
    """Remarks on values that a linear, premultiplied picture hardly has."""
    found = {}
    inside = picture.image[mask > 0.5]
    if len(inside):
        if (inside.min(axis=-1) < -_SOME).mean() > _SOME:
            found[f"{what} negative"] = (
                f"the {what} has negative values (least {inside.min():.3g}): values of -1 to 1 are no linear picture, "
                "map them to 0 to 1 first"
            )
        brightest = inside.max(axis=-1)
        middle = float(np.median(brightest[brightest > _BLACK])) if (brightest > _BLACK).any() else 0.0
        if middle > 1:
            found[f"{what} range"] = (
                f"the {what}'s median (of what is not black in the mask) is {middle:.3g}, brighter than white, "
                "which is 1: if its values are display codes, divide them by the greatest and say that they are srgb"
            )
    if picture.alpha is not None and _shows(picture.image, picture.alpha == 0) > _SOME:
        found[f"{what} straight"] = (
            f"the {what} has colour where its alpha is 0: if colours are not multiplied by alpha, say --alpha straight"
        )
    return found
