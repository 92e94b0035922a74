"""The mean texture: projected from pictures, weighted by the cosine, never read from the true albedo."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from handbench.data.openstage.presets import preset
from handbench.data.openstage.stage import cameras
from handbench.errors import Unsupported
from handbench.hand.openhand import OpenHand, named_pose
from handbench.method import Recording
from handbench.methods.kit.texture import mean_texture
from handbench.render.see.raster import rasterise
from handbench.render.uv.atlas import Atlas
from handbench.scene import Directional, Frame, Mesh, Observation

SIZE = 64


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    hand = OpenHand.load()
    return hand.mesh(hand.neutral(), named_pose("rest"), 1)


def _recording(mesh: Mesh, texture: torch.Tensor, kind: str = "full") -> Recording:
    """Pictures of a texture that glows: what is projected back must be the texture."""
    light = Directional([0.0, 1.0, 0.0], [1.0, 1.0, 1.0])
    frames = [
        Frame("s", "p", kind, named_pose("rest"), mesh, camera, light, "train", kind)
        for camera in cameras(preset("quick"), preset("quick").cameras)
    ]

    def observe(frame: Frame) -> Observation:
        drawn = rasterise(frame.mesh, frame.camera)
        return Observation(np.moveaxis(drawn.sample(texture).numpy(), 0, -1), drawn.alpha)

    return Recording(frames, observe)


def test_a_texture_comes_back_from_its_pictures(mesh: Mesh) -> None:
    atlas = Atlas.of(mesh.topology, SIZE)
    position = torch.from_numpy(atlas.interpolate(mesh.vertices).T).float()
    smooth = atlas.dilate(atlas.scatter(0.5 + 3.0 * position))  # colour is place: smooth over the skin
    found = mean_texture(_recording(mesh, smooth), SIZE)
    seen = found.seen.numpy()
    assert seen.sum() > 0.8 * atlas.count
    error = (found.texture - smooth).abs().numpy()[:, seen]
    assert np.median(error) < 0.004 and np.quantile(error, 0.99) < 0.03


def test_unseen_texels_take_the_nearest_seen_value(mesh: Mesh) -> None:
    found = mean_texture(_recording(mesh, torch.full((3, SIZE, SIZE), 0.4)), SIZE)
    assert not found.seen.all()
    assert torch.allclose(found.texture, torch.tensor(0.4), atol=0.01)


def test_frames_that_are_not_fully_lit_are_not_used(mesh: Mesh) -> None:
    with pytest.raises(Unsupported, match="no fully lit frame"):
        mean_texture(_recording(mesh, torch.ones(3, SIZE, SIZE), kind="olat"), SIZE)
