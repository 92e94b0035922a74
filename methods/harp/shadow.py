"""The soft shadow map of HARP's code: a depth map of the light, looked up at 3 x 3 texels with a soft threshold."""

from __future__ import annotations

import numpy as np

from handbench.render.see.posedmesh import PosedMesh
from handbench.scene import Array

DISTANCE = 1.5
"""Metres from the hand at which the map's camera stands, wherever the light is."""

BIAS, SLOPE = 0.008, 1000.0
"""Metres by which a point may lie behind the map's surface, and slope of the sigmoid per metre."""

_TAPS = np.array([(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1)])


def visibility(mesh: PosedMesh, position: Array, points: Array, size: int) -> Array:
    """How much of the light at `position` (3,) points (N, 3) see, (N,) in [0, 1].

    V = mean over 3 x 3 map texels of sigmoid(1000 (map - (depth - 8 mm))), from a perspective camera at 1.5 m that
    looks at the middle of the hand (`renderer_helper.py`). The map has size x size texels over the hand; the authors'
    is as large as the picture, with its focal length. Where the map sees nothing, nothing is hidden: theirs has -1
    there, which darkens a rim of the silhouette. No gradient goes through it.
    """
    scene = mesh.rays
    towards = np.asarray(position, dtype=np.float64) - mesh.vertices.mean(axis=0)
    z = -towards / max(float(np.linalg.norm(towards)), 1e-9)
    x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    x /= np.linalg.norm(x)
    frame = np.stack([x, np.cross(z, x), z])
    eye = mesh.vertices.mean(axis=0) - DISTANCE * z
    seen = (points - eye) @ frame.T
    depth = seen[:, 2]
    place = seen[:, :2] / depth[:, None]
    low = place.min(axis=0)
    pitch = max(float(np.ptp(place, axis=0).max()), 1e-9) / (size - 3)
    column, row = np.floor((place - low) / pitch).astype(np.int64).T + 1
    taps = (row + _TAPS[:, :1]) * size + column + _TAPS[:, 1:]
    wanted, where = np.unique(taps, return_inverse=True)
    centres = low + pitch * (np.stack([wanted % size, wanted // size], axis=1) - 0.5)
    rays = np.concatenate([centres, np.ones((len(wanted), 1))], axis=1) @ frame
    origin = np.broadcast_to(eye - scene.centre, rays.shape)
    first = scene.distances(np.concatenate([origin, rays], axis=1).astype(np.float32))
    before = np.clip(SLOPE * (first[where].reshape(taps.shape) - (depth - BIAS)), -60.0, 60.0)
    return (1.0 / (1.0 + np.exp(-before))).mean(axis=0)
