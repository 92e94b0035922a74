"""Light transfer by least squares: what it is shown it draws, and light adds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from othercamera import check_seen_by
from scipy.spatial.transform import Rotation

from handbench.errors import Unsupported
from handbench.light.harmonics import harmonics
from handbench.light.lightset import light_samples
from handbench.method import Avatar, Recording
from handbench.methods import mean, transfer
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.uv.atlas import Atlas
from handbench.scene import Directional, Environment, Group, Mesh, Point


@pytest.fixture(scope="module")
def avatar(training: Recording) -> Iterator[Avatar]:
    return transfer.create("smoke").train(training).personalise(training)


def test_it_is_nearer_than_the_mean_under_light_that_was_not_shown(avatar: Avatar, training: Recording, mini) -> None:
    floor = mean.create().train(training).personalise(training)
    frames = [f for f in mini.frames() if f.subject == "s01" and f.segment == "train" and f.lighting == "olat-06"]
    errors = [
        np.mean([np.abs(one.relight(f.query).image - mini.observe(f).image).mean() for f in frames])
        for one in (avatar, floor)
    ]
    assert errors[0] < 0.75 * errors[1], errors


def test_another_camera_shares_the_pose(avatar: Avatar, training: Recording) -> None:
    for one in (avatar, mean.create().train(training).personalise(training)):
        check_seen_by(one, training.frames[0].query)


def test_light_adds(avatar: Avatar, training: Recording) -> None:
    posed = avatar.pose(training.frames[0].viewpoint)
    lights = (
        Directional((0.0, 0.6, 0.8), (1.0, 0.5, 0.2)),
        Point((0.1, 0.2, 0.4), (0.2, 0.2, 0.3)),
        Environment("sky", np.random.default_rng(0).random((4, 8, 3), dtype=np.float32)),
    )
    sum_ = sum(posed.relight(light).image for light in lights)
    assert np.allclose(posed.relight(Group(lights)).image, sum_, atol=1e-5)


def test_what_a_texel_sees_turns_with_the_hand(training: Recording) -> None:
    mesh = training.frames[0].mesh
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    turned = Mesh(mesh.vertices @ turn.T + [0.1, 0.0, -0.2], mesh.topology)
    atlas = Atlas.of(mesh.topology, 64)
    direction = np.array([0.48, 0.6, 0.64])
    found = [
        transfer.TexelFrames.of(PosedMesh(one), atlas, 3).light(light_samples(Directional(towards, (1.0, 1.0, 1.0))))
        for one, towards in ((mesh, direction), (turned, turn @ direction))
    ]
    assert np.allclose(*found, atol=1e-4)


def test_many_lights_are_seen_as_one_after_the_other(training: Recording) -> None:
    mesh = training.frames[0].mesh
    frames = transfer.TexelFrames.of(PosedMesh(mesh), Atlas.of(mesh.topology, 32), 3)
    lights = light_samples(Environment("sky", np.random.default_rng(0).random((4, 8, 3), dtype=np.float32)))
    total = sum(
        harmonics(frames.axes @ direction, 3)[..., None] * power
        for direction, power in zip(lights.directions, lights.irradiance, strict=True)
    )
    assert np.allclose(frames.light(lights), total, atol=1e-12)


def test_without_lights_it_is_refused(training: Recording) -> None:
    with pytest.raises(Unsupported, match="frames with few lights"):
        transfer.create("smoke").train(training).personalise(training.of_kind("full"))


def test_another_topology_is_refused(avatar: Avatar, training: Recording) -> None:
    from handbench.hand import hand_model

    hand = hand_model()
    finer = hand.mesh(hand.neutral(), hand.named_pose("rest"), 2)
    with pytest.raises(Unsupported, match="another topology"):
        avatar.pose(replace(training.frames[0].viewpoint, mesh=replace_uvs(finer)))


def replace_uvs(mesh: Mesh) -> Mesh:
    """The mesh with half of its texture unused."""
    from handbench.scene import Topology

    uvs, faces = mesh.topology.unwrapped
    return Mesh(mesh.vertices, Topology(mesh.topology.faces, 0.5 * uvs, faces))
