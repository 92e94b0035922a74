"""What was recorded in a frame (an observation), and what a method answers to a query (a prediction)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from .arrays import Array
from .arrays import checked as _array
from .arrays import measured as _measured
from .arrays import put as _set
from .mesh import Mesh


@dataclass(frozen=True, eq=False)
class Observation:
    """What was recorded in a frame: image (H, W, 3), and alpha (H, W) and geometry channels where there are any.

    normal (H, W, 3) in world space, depth (H, W) in metres along z, uv (H, W, 2); zero where alpha is zero.
    keypoints (K, 3): where a detector saw the hand model's key points, x and y in pixels, and how sure it was, 0 to 1.
    scan: the surface as a scanner measured it in the frame's pose; its topology is its own.
    """

    image: Array
    alpha: Array | None = None
    normal: Array | None = None
    depth: Array | None = None
    uv: Array | None = None
    keypoints: Array | None = None
    scan: Mesh | None = None

    def __post_init__(self) -> None:
        given = _measured("observation", "image", self.image)
        image = _array("observation", "image", given, (None, None, 3), np.float32)
        _set(self, "image", image)
        height, width = image.shape[:2]
        for name, channels in (("alpha", ()), ("normal", (3,)), ("depth", ()), ("uv", (2,))):
            value = getattr(self, name)
            if value is not None:
                value = _measured("observation", name, value)
                _set(self, name, _array("observation", name, value, (height, width, *channels), np.float32))
        if self.keypoints is not None:
            _set(self, "keypoints", _array("observation", "keypoints", self.keypoints, (None, 3), np.float64))


@dataclass(frozen=True, eq=False)
class Prediction:
    """A method's answer to a query: image (H, W, 3), linear, premultiplied, and alpha (H, W).

    What it knows of the geometry it drew may come along: depth (H, W) in metres along the camera's z and normal
    (H, W, 3), unit, in world space, both of the visible surface and zero where there is none; a mesh; joints (J, 3)
    in metres. Depth and normal may be anything with a `shape` that numpy can read: they are worked out (`__array__`)
    if something asks for them. Give what the method found; what it was given is no answer.

    Values are not checked for NaN here: a method that diverges must be seen, so scoring does it.
    """

    image: Array
    alpha: Array
    depth: ArrayLike | None = None
    normal: ArrayLike | None = None
    mesh: Mesh | None = None
    joints: Array | None = None

    def __post_init__(self) -> None:
        image = _measured("prediction", "image", self.image).astype(np.float32, copy=False)
        alpha = _measured("prediction", "alpha", self.alpha).astype(np.float32, copy=False)
        if image.ndim != 3 or image.shape[2] != 3 or alpha.shape != image.shape[:2]:
            raise InputError(
                f"prediction: image {image.shape} and alpha {alpha.shape} do not fit; expected (H, W, 3) and (H, W)"
            )
        for name, channels in (("depth", ()), ("normal", (3,))):
            value, expected = getattr(self, name), (*alpha.shape, *channels)
            if value is not None and np.shape(value) != expected:
                raise InputError(f"prediction: {name} has shape {np.shape(value)}, expected {expected} as its image")
        if not isinstance(self.mesh, Mesh | None):
            raise InputError(f"prediction: mesh is a {type(self.mesh).__name__}; give a handbench.scene.Mesh")
        if self.joints is not None:
            joints = np.asarray(self.joints, dtype=np.float64)
            if joints.ndim != 2 or joints.shape[1] != 3:
                raise InputError(f"prediction: joints have shape {joints.shape}, expected (n, 3)")
            _set(self, "joints", joints)
        _set(self, "image", image)
        _set(self, "alpha", alpha)
