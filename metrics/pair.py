"""What a metric is asked to judge: a prediction and its truth, as pictures and, where there is any, as geometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handbench.errors import InputError
from handbench.scene import Mesh, Observation, Prediction, needed


@dataclass(frozen=True, eq=False)
class Pair:
    """A prediction and its truth, (H, W, 3) linear premultiplied, and the truth's alpha `mask` (H, W).

    Geometry is optional: the prediction's alpha (H, W), depth along z (H, W) in metres, normals (H, W, 3), a mesh,
    joints (J, 3) in metres. Depth and normals are zero where there is no surface, as in `scene.Observation`; those of
    the prediction may be worked out when a metric asks for them, as in `scene.Prediction`.

    Raises `InputError` if the shapes differ, if an image holds integers, or if anything of the truth is not finite.
    A prediction with NaN is no error: its score says so.
    """

    prediction: NDArray[Any]
    truth: NDArray[Any]
    mask: NDArray[Any]
    prediction_alpha: NDArray[Any] | None = None
    prediction_depth: ArrayLike | None = None
    truth_depth: NDArray[Any] | None = None
    prediction_normal: ArrayLike | None = None
    truth_normal: NDArray[Any] | None = None
    prediction_mesh: Mesh | None = None
    truth_mesh: Mesh | None = None
    prediction_joints: NDArray[Any] | None = None
    truth_joints: NDArray[Any] | None = None

    @classmethod
    def of(cls, prediction: Prediction, truth: Observation, mesh: Mesh | None = None) -> Pair:
        """A method's answer and what was recorded of the same frame, `mesh` being the frame's tracked mesh."""
        return cls(
            prediction.image,
            truth.image,
            needed(truth.alpha, "alpha"),
            prediction_alpha=prediction.alpha,
            prediction_depth=prediction.depth,
            truth_depth=truth.depth,
            prediction_normal=prediction.normal,
            truth_normal=truth.normal,
            prediction_mesh=prediction.mesh,
            truth_mesh=mesh,
            prediction_joints=prediction.joints,
        )

    def __post_init__(self) -> None:
        prediction, truth, mask = (np.asarray(a) for a in (self.prediction, self.truth, self.mask))
        if prediction.shape != truth.shape:
            raise InputError(f"prediction {prediction.shape} and truth {truth.shape} differ in shape; draw at its size")
        if truth.ndim != 3 or truth.shape[2] != 3 or truth.size == 0:
            raise InputError(f"prediction and truth have shape {truth.shape}, expected (H, W, 3)")
        if mask.shape != truth.shape[:2]:
            raise InputError(f"mask {mask.shape} does not fit the truth {truth.shape}, expected {truth.shape[:2]}")
        for name, image in (("prediction", prediction), ("truth", truth)):
            if image.dtype.kind != "f":
                raise InputError(
                    f"{name} has dtype {image.dtype}; give linear floating-point values, not display codes"
                )
        for name, array in (("prediction", prediction), ("truth", truth), ("mask", mask)):
            self._keep(name, array)
        self._check_geometry(mask.shape)

    def _check_geometry(self, size: tuple[int, ...]) -> None:
        sides = ("prediction", "truth")
        shapes = {"prediction_alpha": size}
        shapes |= {f"{side}_depth": size for side in sides} | {f"{side}_normal": (*size, 3) for side in sides}
        for name, shape in shapes.items():
            if getattr(self, name) is not None:
                array = getattr(self, name)
                array = array if hasattr(array, "shape") else np.asarray(array)
                if array.shape != shape:
                    raise InputError(f"{name} has shape {array.shape}, expected {shape} as the image has")
                self._keep(name, array)
        for name in ("prediction_mesh", "truth_mesh"):
            mesh = getattr(self, name)
            if mesh is not None and not isinstance(mesh, Mesh):
                raise InputError(f"{name} is a {type(mesh).__name__}; give a handbench.scene.Mesh")
        for name in ("prediction_joints", "truth_joints"):
            if getattr(self, name) is not None:
                joints = np.asarray(getattr(self, name))
                if joints.ndim != 2 or joints.shape[1] != 3:
                    raise InputError(f"{name} has shape {joints.shape}, expected (J, 3) in metres")
                self._keep(name, joints)

    def _keep(self, name: str, array: NDArray[Any]) -> None:
        """Store an array; what belongs to the truth must be finite."""
        if not name.startswith("prediction"):
            bad = int(np.count_nonzero(~np.isfinite(array)))
            if bad:
                raise InputError(f"{name} holds {bad} values that are NaN or infinite; the capture is damaged")
        object.__setattr__(self, name, array)
