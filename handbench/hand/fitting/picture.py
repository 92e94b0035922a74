"""What a hand is fitted to: key points, a mask and depth of one picture, and a close-up of them to work on."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from PIL import Image
from scipy.ndimage import distance_transform_edt, label, map_coordinates

from ...errors import InputError
from ...scene import Array, Camera, Pose
from .problems import Kind, Problem

SIDE = 192  # pixels of a close-up's longer side
MARGIN = 0.15  # of the hand's box, kept free around it
LEAST_POINTS = 8
_GUESSED = 0.1  # how sure a detector is of what it does not see
_LEAST_MASK = 30  # pixels
_SPECK = 0.04  # of the largest piece of a mask: smaller ones are no fingers


@dataclass(frozen=True, eq=False)
class HandPicture:
    """A hand as one camera saw it: `key_points` (21, 2) are the places of the hand model's 21, whatever they are.

    Places are in pixels from the upper left corner, NaN where a point was not found; with a third column they come with
    how sure the detector was, 0 to 1 (1 without), which is then in `sure` (21,). alpha (H, W) in [0, 1] is the
    hand's mask, depth (H, W) in metres along z, 0 where nothing was measured; either may be None. `start` is a pose
    as a tracker tells it: the fit also begins there, and stays near it (see `Tracker`). Raises `InputError` for shapes
    that do not fit.
    """

    camera: Camera
    key_points: Array
    alpha: Array | None = None
    depth: Array | None = None
    name: str = "picture"
    start: Pose | None = None
    sure: Array = field(default_factory=lambda: np.ones(21))

    def __post_init__(self) -> None:
        points = np.asarray(self.key_points, dtype=np.float64)
        if points.shape not in ((21, 2), (21, 3)):
            text = f"key points have shape {points.shape}, expected (21, 2), or (21, 3) with how sure each is"
            raise InputError(f"{self.name}: {text}; write NaN where none was found")
        object.__setattr__(self, "key_points", points[:, :2])
        sure = points[:, 2] if points.shape[1] == 3 else np.asarray(self.sure, dtype=np.float64)
        object.__setattr__(self, "sure", np.clip(np.nan_to_num(sure), 0.0, 1.0))
        for name in ("alpha", "depth"):
            value = getattr(self, name)
            if value is None:
                continue
            value = np.asarray(value, dtype=np.float32)
            expected = (self.camera.height, self.camera.width)
            if value.shape != expected:
                raise InputError(f"{self.name}: {name} has shape {value.shape}, expected {expected} as its camera")
            if not np.isfinite(value).all():
                raise InputError(f"{self.name}: {name} holds NaN or infinity; write 0 where nothing is known")
            object.__setattr__(self, name, value)

    @property
    def seen(self) -> Array:
        """Which key points (21,) were found inside the picture, not just guessed."""
        with np.errstate(invalid="ignore"):
            inside = (self.key_points >= 0) & (self.key_points <= (self.camera.width, self.camera.height))
        return np.asarray(inside.all(axis=1)) & (self.sure > _GUESSED)

    def problem(self) -> Problem | None:
        """What makes a fit impossible, if anything does; looks at nothing but the picture."""
        found = int(self.seen.sum())
        if found < LEAST_POINTS:
            return self._problem(
                "no key points",
                f"{found or 'no'} key points are given inside the picture, and a fit needs {LEAST_POINTS}; "
                "run a hand detector, or leave the picture out",
            )
        if self.alpha is None:
            return None
        mask = self.alpha > 0.5
        if mask.sum() < _LEAST_MASK:
            text = f"the mask covers {int(mask.sum())} pixels; give the hand's alpha in [0, 1], or no mask"
            return self._problem("empty mask", text)
        return self._other_hand_in(mask)

    def _other_hand_in(self, mask: Array) -> Problem | None:
        """A piece of the mask of a hand's size on which no key point lies."""
        pieces, count = label(mask)
        if count < 2:
            return None
        area = np.bincount(pieces.ravel(), minlength=count + 1)[1:]
        column, row = np.floor(self.key_points[self.seen]).astype(int).T
        on = pieces[row.clip(0, len(mask) - 1), column.clip(0, mask.shape[1] - 1)]
        ours = np.bincount(on, minlength=count + 1)[1:]
        other = np.where(ours <= 0.05 * self.seen.sum(), area, 0).max()
        if other < 0.25 * area[ours > 0].max(initial=1):
            return None
        return self._problem(
            "two hands",
            f"the mask has a second piece of {int(other)} pixels without key points, beside the hand's "
            f"{int(area[ours > 0].max(initial=0))}; give the mask of one hand",
        )

    def _problem(self, kind: Kind, text: str) -> Problem:
        return Problem(kind, self.name, text)


@dataclass(frozen=True, eq=False)
class CloseUp:
    """The hand's part of a picture at about `SIDE` pixels, in the camera's own frame.

    K (3, 3), width and height are of the close-up, key_points (21, 2) and outside (H, W), the signed distance to the
    mask's outline in pixels (positive outside, None without a mask), too, and slope (2, H, W) its gradient in x and y;
    depth (H, W) metres, 0 where unknown.
    """

    picture: HandPicture
    K: Array
    width: int
    height: int
    key_points: Array
    seen: Array
    alpha: Array | None
    outside: Array | None
    slope: Array | None
    depth: Array | None

    @staticmethod
    def of(picture: HandPicture) -> CloseUp:
        """The close-up of a picture without a `problem`."""
        camera, seen = picture.camera, picture.seen
        points = picture.key_points[seen]
        low, high = points.min(axis=0), points.max(axis=0)
        mask = None if picture.alpha is None else _without_specks(picture.alpha)
        if mask is not None:
            rows, columns = np.nonzero(mask > 0.5)
            low = np.minimum(low, [columns.min(), rows.min()])
            high = np.maximum(high, [columns.max() + 1, rows.max() + 1])
        margin = MARGIN * (high - low).max() + 1.0
        left, top = np.floor(np.maximum(low - margin, 0))
        right, bottom = np.ceil(np.minimum(high + margin, (camera.width, camera.height)))
        scale = min(1.0, SIDE / max(right - left, bottom - top))
        width, height = (max(8, round(scale * size)) for size in (right - left, bottom - top))
        scales = np.array([width / (right - left), height / (bottom - top)])
        K = np.diag([*scales, 1.0]) @ (camera.K - np.array([[0, 0, left], [0, 0, top], [0, 0, 0]]))
        box = (left, top, right, bottom)
        size, how = (width, height), Image.Resampling
        alpha = None if mask is None else _reduced(mask, size, box, how.BOX)
        depth = None if picture.depth is None else _reduced(picture.depth, size, box, how.NEAREST)
        if alpha is not None and depth is not None:
            depth = np.where(alpha > 0.5, depth, 0.0)  # what is behind the hand is not its surface
        outside = None if alpha is None else signed_distance(alpha > 0.5)
        places = (picture.key_points - [left, top]) * scales
        slope = None if outside is None else np.stack([np.gradient(outside, axis=axis) for axis in (1, 0)])
        return CloseUp(picture, K, width, height, places, seen, alpha, outside, slope, depth)

    @property
    def trust(self) -> Array:
        """What the seen key points (n,) weigh beside others, from how sure the detector was; 1 on average."""
        trust = self.picture.sure[self.seen] ** 2
        return trust / trust.mean()

    @property
    def untold(self) -> CloseUp:
        """Without the pose that the picture brings."""
        return replace(self, picture=replace(self.picture, start=None))

    def mirrored(self) -> CloseUp:
        """What is seen in a mirror: the other hand, as a hand of this side; the pose is none of that."""
        K = np.diag([-1.0, 1.0, 1.0]) @ self.K
        K[0] = [-K[0, 0], K[0, 1], K[0, 2] + self.width]
        flat, slope = (None if m is None else m[..., ::-1] for m in (self.depth, self.slope))
        return replace(
            self.untold,
            K=K,
            key_points=np.array([self.width, 0]) + np.array([-1, 1]) * self.key_points,
            alpha=None if self.alpha is None else self.alpha[:, ::-1],
            outside=None if self.outside is None else self.outside[:, ::-1],
            slope=None if slope is None else np.array([-1.0, 1.0])[:, None, None] * slope,
            depth=flat,
        )

    def places(self, points: Array) -> Array:
        """The places (..., 2) of points (..., 3) in the camera's frame, which must be in front of it."""
        pixels = points @ self.K.T
        return pixels[..., :2] / pixels[..., 2:]

    def moving(self, points: Array) -> Array:
        """How the places move with the points, (..., 2, 3)."""
        pixels = points @ self.K.T
        places = pixels[..., :2] / pixels[..., 2:]
        return (self.K[:2] - places[..., None] * self.K[2]) / pixels[..., 2, None, None]


def _without_specks(alpha: Array) -> Array:
    """The alpha without pieces that are small beside the largest."""
    pieces, _ = label(alpha > 0.5)
    area = np.bincount(pieces.ravel())
    area[0] = area[1:].max(initial=0)
    return np.where(area[pieces] >= _SPECK * area[0], alpha, 0.0)


def _reduced(values: Array, size: tuple[int, int], box: tuple[float, ...], how: Image.Resampling) -> Array:
    return np.asarray(Image.fromarray(values).resize(size, how, box=box))  # type: ignore[arg-type]


def signed_distance(mask: Array) -> Array:
    """Distance (H, W) in pixels of pixel centres to the outline of a mask: positive outside, negative inside.

    What lies beyond the picture's edge is not known, so the edge is no outline. A mask of everything is far inside.
    """
    far = float(sum(mask.shape))
    outside = distance_transform_edt(~mask) if mask.any() else np.full(mask.shape, far)
    inside = distance_transform_edt(mask) if not mask.all() else np.full(mask.shape, far)
    return np.where(mask, 0.5 - inside, outside - 0.5)


def sampled(values: Array, places: Array) -> Array:
    """Bilinear values (n,) of a map (H, W) at places (n, 2); the border's beyond it."""
    return map_coordinates(values, places[:, ::-1].T - 0.5, order=1, mode="nearest")
