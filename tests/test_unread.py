"""Poses and meshes that are read when they are looked at are like any other then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from handbench.bench.lending import copied
from handbench.errors import InputError
from handbench.scene import Mesh, Pose, Topology

TRIANGLE = Topology(np.array([[0, 1, 2]]))


def test_they_are_read_once_and_no_earlier() -> None:
    read: list[str] = []

    def pose() -> Pose:
        read.append("pose")
        return Pose(np.ones((2, 3)), [1, 0, 0], [0, 0, 1])

    def vertices() -> np.ndarray:
        read.append("mesh")
        return np.eye(3)

    lazy, mesh = Pose.unread(pose), Mesh.unread(vertices, TRIANGLE)
    assert mesh.topology is TRIANGLE and not read
    assert lazy.rotation.tolist() == [1, 0, 0] and lazy.joints.shape == (2, 3) and lazy.translation[2] == 1
    assert np.array_equal(mesh.vertices, np.eye(3)) and mesh.vertices is mesh.vertices
    assert read == ["pose", "mesh"] and not mesh.vertices.flags.writeable


def test_they_can_be_replaced_and_lent() -> None:
    lazy = Pose.unread(lambda: Pose(np.ones((2, 3))))
    assert replace(lazy, rotation=[0, 1, 0]).joints.shape == (2, 3)
    mesh = Mesh.unread(lambda: np.eye(3), TRIANGLE)
    twin = copied(mesh)
    assert np.array_equal(twin.vertices, mesh.vertices) and twin.vertices is not mesh.vertices


def test_what_is_wrong_is_told_where_it_is_looked_at() -> None:
    mesh = Mesh.unread(lambda: np.zeros((2, 3)), TRIANGLE)
    with pytest.raises(InputError, match="faces point outside the 2 vertices"):
        _ = mesh.vertices
    with pytest.raises(AttributeError, match="a pose has no angle"):
        _ = Pose(np.zeros((1, 3))).angle  # type: ignore[attr-defined]
