"""The law of `PosedAvatar.seen_by`: a pose that is shared with another camera draws what one posed anew draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from handbench.method import Avatar
from handbench.scene import Camera, Query


def beside(camera: Camera) -> Camera:
    """A camera that stands a little apart and sees another size."""
    turn = Rotation.from_rotvec([0.0, 0.05, 0.1]).as_matrix()
    placed = np.c_[turn @ camera.rotation, turn @ camera.world_to_camera[:, 3]]
    return replace(camera, name="beside", width=camera.width - 2, world_to_camera=placed)


def check_seen_by(avatar: Avatar, query: Query) -> None:
    first = avatar.pose(query.viewpoint)
    before = first.relight(query.light).image
    other = beside(query.camera)
    shared = first.seen_by(other).relight(query.light)
    anew = avatar.relight(replace(query, camera=other))
    assert shared.image.shape == anew.image.shape and anew.image.max() > 0
    np.testing.assert_array_equal(shared.alpha, anew.alpha)
    # shadows of cells are filled in between other texels
    assert np.abs(shared.image - anew.image).mean() < 0.005 * anew.image.mean()
    np.testing.assert_array_equal(first.relight(query.light).image, before)
