"""MeshLab's word on the hand's surface and on how far the tracked mesh is from the truth."""

from __future__ import annotations

import numpy as np
import pymeshlab
import pytest

from handbench.data.openstage.performance import TRACKING_NOISE, smooth_noise
from handbench.hand.openhand import OpenHand, named_pose, sample_pose
from handbench.scene import Mesh


def _meshlab(mesh: Mesh) -> pymeshlab.Mesh:
    return pymeshlab.Mesh(mesh.vertices, mesh.topology.faces)


@pytest.mark.parametrize("level", [0, 1, 2])
def test_the_surface_is_closed_manifold_and_without_handles(level: int) -> None:
    hand = OpenHand.load()
    mesh = hand.mesh(hand.sample_identity(np.random.default_rng(3)), named_pose("open"), level)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(_meshlab(mesh))
    measures = meshes.get_topological_measures()
    assert measures["boundary_edges"] == 0
    assert measures["is_mesh_two_manifold"]
    assert measures["genus"] == 0
    assert measures["connected_components_number"] == 1
    volume = meshes.get_geometric_measures()["mesh_volume"]
    assert 2.5e-4 < volume < 9e-4  # a hand and a piece of forearm displace a quarter to nine tenths of a litre


def test_the_tracked_mesh_errs_by_a_fraction_of_a_millimetre() -> None:
    hand = OpenHand.load()
    pose = sample_pose(np.random.default_rng(5))
    truth = hand.mesh(hand.neutral(), pose, 3)
    coarse = hand.mesh(hand.neutral(), pose, 1)
    noise = smooth_noise(coarse.topology, len(coarse.vertices), np.random.default_rng(0))
    tracked = Mesh(coarse.vertices + noise, coarse.topology)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(_meshlab(truth))
    meshes.add_mesh(_meshlab(tracked))
    distance = meshes.get_hausdorff_distance(sampledmesh=1, targetmesh=0, samplevert=True)
    assert distance["max"] < 1.5e-3
    assert 0.1 * TRACKING_NOISE < distance["mean"] < TRACKING_NOISE
