"""What PALM-Net's prior trains on: poses of people with all their pictures, and places around the skin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from handbench.errors import Unsupported
from handbench.hand import HandModel
from handbench.hand.canonical import skinning_weights
from handbench.lean import open3d
from handbench.method import Recording
from handbench.render.see.posedmesh import PosedMesh
from handbench.scene import Array, Camera, Frame, Mesh, Observation, Pose, needed

from .pixels import SHARES, near_edge, square
from .registration import registered

_MARGIN = 6  # pixels around the hand that are trained on
_BANK = 4096  # places around the skin of a pose
_SPREAD = (2e-3, 8e-3)  # metres, of those that are off the skin: one half each
_EDGE = 2  # pixels


@dataclass(frozen=True, eq=False)
class TrainingCrop:
    """The part of a frame with the hand in it: image (h, w, 3) linear, alpha (h, w), normal (h, w, 3) or None; corner
    (x, y) of its first pixel in the camera's picture."""

    camera: Camera
    corner: tuple[int, int]
    image: Tensor
    alpha: Tensor
    normal: Tensor | None

    @cached_property
    def edge(self) -> Array:
        """Flat pixels near the edge of the hand: every step asks for some."""
        return np.flatnonzero(near_edge(self.alpha.numpy() > 0.5, _EDGE)).astype(np.int32)

    def rays(self, row: Tensor, column: Tensor) -> tuple[Tensor, Tensor]:
        """Origins and unit directions (N, 3) through the middles of pixels."""
        x, y = column + (self.corner[0] + 0.5), row + (self.corner[1] + 0.5)
        matrix = torch.from_numpy(self.camera.ray_matrix).float()
        directions = torch.stack([x, y, torch.ones_like(x)], dim=1) @ matrix
        origin = torch.from_numpy(self.camera.centre.copy()).float()
        return origin.expand(len(x), 3), torch.nn.functional.normalize(directions, dim=1)


@dataclass(frozen=True, eq=False)
class Bank:
    """Places (M, 3) in the world around a pose's skin, the first half on it: signed distances (M,) in metres, and
    normals (M, 3), which mean something on the skin."""

    points: Tensor
    distance: Tensor
    normal: Tensor

    @staticmethod
    def of(mesh: Mesh, rng: np.random.Generator) -> Bank:
        """Around a closed mesh, evenly by area."""
        faces = mesh.topology.faces
        corners = mesh.vertices[faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(across, axis=1)
        chosen = rng.choice(len(faces), _BANK, p=area / area.sum())
        share = rng.dirichlet([1.0, 1.0, 1.0], _BANK)[..., None]
        normals = PosedMesh(mesh).normals[faces[chosen]]
        normal = (share * normals).sum(axis=1)
        points = (share * corners[chosen]).sum(axis=1)
        spread = np.resize(_SPREAD, _BANK - _BANK // 2)[:, None]
        points[_BANK // 2 :] += spread * rng.standard_normal((len(spread), 3))
        centre = points.mean(axis=0)  # float32 is for near the origin
        o3d = open3d()
        tensor, scene = o3d.core.Tensor, o3d.t.geometry.RaycastingScene()
        scene.add_triangles(
            tensor.from_numpy((mesh.vertices - centre).astype(np.float32)),
            tensor.from_numpy(np.ascontiguousarray(faces, dtype=np.uint32)),
        )
        distance = scene.compute_signed_distance(tensor.from_numpy((points - centre).astype(np.float32))).numpy()
        distance[: _BANK // 2] = 0.0
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        return Bank(*(torch.from_numpy(np.asarray(a, dtype=np.float32)) for a in (points, distance, normal)))


@dataclass(frozen=True, eq=False)
class Taken:
    """One pose of a person: number `person`, shape (S,), pose, pictures, places around the skin, and a mesh that
    shadows fall from."""

    person: int
    shape: Tensor
    pose: Pose
    pictures: tuple[TrainingCrop, ...]
    bank: Bank
    mesh: Mesh


@dataclass(frozen=True, eq=False)
class Rays:
    """Pixels to learn: rays (R, 3) and what they show. The last `patch` squared ones are a square patch, row by row.

    image (R, 3) linear and premultiplied, alpha (R,), normal (R, 3) in the world or None.
    """

    origins: Tensor
    directions: Tensor
    image: Tensor
    alpha: Tensor
    normal: Tensor | None
    patch: int


def taken(recording: Recording, hand: HandModel, register: bool, seed: int) -> list[Taken]:
    """All poses of a recording, people numbered as they first appear.

    PALM-Net learns the light of one studio, so of several lightings only the first one's frames are used, fully lit
    ones before others. With `register` poses and shapes are fitted to scans if all poses of a person have one. Raises
    `Unsupported` for a recording without frames, pictures without a hand, and poses of another hand model;
    `InputError` for a hand model without skinning weights.
    """
    skinning_weights(hand, 0)
    frames = recording.of_kind("full").frames or recording.frames
    if not frames:
        raise Unsupported("palm trains on pictures of hands, and there are no training frames")
    frames = tuple(frame for frame in frames if frame.lighting == frames[0].lighting)
    people: dict[str, dict[str, list[Frame]]] = {}
    for frame in frames:
        people.setdefault(frame.subject, {}).setdefault(frame.pose_name, []).append(frame)
    found = []
    for person, poses in enumerate(people.values()):
        found += _person(recording, hand, person, list(poses.values()), register, seed)
    return found


def _person(
    recording: Recording, hand: HandModel, person: int, poses: Sequence[Sequence[Frame]], register: bool, seed: int
) -> list[Taken]:
    first = poses[0][0]
    shape = np.asarray(hand.neutral() if first.shape is None else first.shape, dtype=np.float64)
    told = [needed(frames[0].pose, "pose") for frames in poses]
    for pose, frames in zip(told, poses, strict=True):
        if len(pose.joints) != len(hand.parents):
            raise Unsupported(
                f"palm works with the hand model {hand.name!r} of {len(hand.parents)} joints, and the pose of "
                f"{frames[0].key} has {len(pose.joints)}"
            )
    seen = [[(frame, recording.observe(frame)) for frame in frames] for frames in poses]
    scans = [observed[0][1].scan for observed in seen]
    scanned = [scan for scan in scans if scan is not None]
    if register and len(scanned) == len(scans):
        shape, registrations = registered(hand, shape, told, scanned)
        told = list(registrations)
    size = torch.tensor(shape, dtype=torch.float32)
    found = []
    for number, (pose, observed, scan) in enumerate(zip(told, seen, scans, strict=True)):
        mesh = hand.mesh(shape, pose, min(1, hand.levels))
        bank = Bank.of(mesh if scan is None else scan, np.random.default_rng([23, seed, person, number]))
        pictures = tuple(_picture(frame, observation) for frame, observation in observed)
        found.append(Taken(person, size, pose, pictures, bank, mesh))
    return found


def _picture(frame: Frame, seen: Observation) -> TrainingCrop:
    alpha = needed(seen.alpha, "alpha")
    rows, columns = np.nonzero(alpha > 0)
    if not len(rows):
        raise Unsupported(f"palm trains on pictures of a hand, and the mask of {frame.key} is empty")
    top, left = max(0, rows.min() - _MARGIN), max(0, columns.min() - _MARGIN)
    box = (slice(top, rows.max() + _MARGIN + 1), slice(left, columns.max() + _MARGIN + 1))

    def part(values: Array) -> Tensor:
        return torch.from_numpy(values[box].astype(np.float16))

    normal = None if seen.normal is None else part(seen.normal)
    return TrainingCrop(frame.camera, (int(left), int(top)), part(seen.image), part(alpha), normal)


def drawn(pose: Taken, count: int, patch: int, rng: np.random.Generator) -> Rays:
    """`count` random pixels of all pictures of a pose, and a random patch of one of them that shows the hand.

    Raises `Unsupported` for pictures that are smaller than a patch.
    """
    parts: list[tuple[TrainingCrop, Array, Array]] = []
    which = rng.integers(len(pose.pictures), size=count)
    for number, picture in enumerate(pose.pictures):
        parts.append((picture, *_pixels(picture, int((which == number).sum()), rng)))
    if patch:
        parts.append(_patch(pose.pictures[int(rng.integers(len(pose.pictures)))], patch, rng))
    origins, directions, image, alpha, normal = [], [], [], [], []
    for picture, row, column in parts:
        r, c = torch.from_numpy(row), torch.from_numpy(column)
        start, towards = picture.rays(r.float(), c.float())
        origins.append(start)
        directions.append(towards)
        image.append(picture.image[r, c].float())
        alpha.append(picture.alpha[r, c].float())
        if picture.normal is not None:
            normal.append(picture.normal[r, c].float())
    return Rays(
        torch.cat(origins),
        torch.cat(directions),
        torch.cat(image),
        torch.cat(alpha),
        torch.cat(normal) if len(normal) == len(parts) else None,
        patch,
    )


def _pixels(picture: TrainingCrop, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Rows and columns (count,) of random pixels: of the mask, its edge, and the rest."""
    mask = picture.alpha.numpy() > 0.5
    kinds = [np.flatnonzero(mask), picture.edge, np.flatnonzero(~mask)]
    shares = np.array([share if len(kind) else 0.0 for share, kind in zip(SHARES, kinds, strict=True)])
    of = rng.choice(3, count, p=shares / shares.sum())
    flat = np.concatenate([rng.choice(kind, int((of == k).sum())) for k, kind in enumerate(kinds) if len(kind)])
    row, column = np.divmod(flat, mask.shape[1])
    return row, column


def _patch(picture: TrainingCrop, side: int, rng: np.random.Generator) -> tuple[TrainingCrop, Array, Array]:
    height, width = picture.alpha.shape
    if min(height, width) < side:
        raise Unsupported(
            f"palm compares patches of {side} x {side} pixels, and the hand in a picture of camera "
            f"{picture.camera.name!r} is {width} x {height}; take larger pictures or set a smaller patch"
        )
    return picture, *square(picture.alpha.numpy() > 0.5, side, rng)
