"""Shadows at texels that a network looks at and a picture does not: few are traced, and the picture hardly changes."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from handbench.data.capture import Capture
from handbench.methods.kit.sampling import Sampling
from handbench.methods.urhand.config import PRESETS
from handbench.methods.urhand.method import PosedURHand
from handbench.methods.urhand.model import URHandModel
from handbench.render.see.raster import rasterise
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Frame, Group
from handbench.skips import Skips, skipping, tallied


def _frames(mini: Capture, kind: str) -> list[Frame]:
    return [frame for frame in mini.frames() if frame.kind == kind]


def _model(frame: Frame) -> URHandModel:
    """Off its start, where each texel is on its own, as a short training takes it."""
    torch.manual_seed(0)
    model = URHandModel(PRESETS["quick"], len(frame.pose.joints)).eval()
    with torch.no_grad():
        for parameter in model.neural.decoder.parameters():
            parameter += 0.02 * torch.randn_like(parameter) * parameter[0].numel() ** -0.5
    return model


def test_texels_take_the_value_of_one_next_to_them_in_their_chart(mini: Capture) -> None:
    frame = _frames(mini, "environment")[0]
    atlas, raster = PosedSurface(frame.mesh, 128).atlas, rasterise(frame.mesh, frame.camera)
    sampling = Sampling.of(atlas, raster)
    taken = sampling.texels[sampling.source.numpy()]
    assert np.array_equal(taken[sampling.texels], sampling.texels)
    looked_up = np.flatnonzero(atlas.needed(raster.texels(128)))
    assert np.isin(looked_up, sampling.texels).all() and len(sampling.texels) < 0.8 * atlas.count
    assert np.array_equal(atlas.chart[taken], atlas.chart)
    row, column = np.divmod(atlas.texels, 128)
    assert max(np.abs(place[taken] - place).max() for place in (row, column)) <= 4


@pytest.mark.parametrize("kind", ["environment", "olat"])
def test_a_network_s_picture_hardly_changes(mini: Capture, kind: str) -> None:
    frame = _frames(mini, kind)[0]
    model = _model(frame)
    images, tallies = [], []
    for chosen in (Skips(), Skips(unseen=False)):
        with skipping(chosen), tallied() as tally:
            images.append(
                PosedURHand(model, torch.full((3, 128, 128), 0.3), frame.viewpoint).relight(frame.light).image
            )
        tallies.append(tally.lines())
    ours, whole = images
    if kind == "environment":
        assert 0.0 < np.linalg.norm(ours - whole) < 0.01 * np.linalg.norm(whole)
        assert tallies[0]["texels out of sight"].skipped > 0 and "texels out of sight" not in tallies[1]
    else:
        assert np.array_equal(ours, whole)


def test_an_environment_and_a_lamp_add_up(mini: Capture) -> None:
    """Though most texels out of sight have the features of others under the one, and their own under the other."""
    frame = _frames(mini, "environment")[0]
    lights = [frame.light, _frames(mini, "olat")[0].light.scaled(3.0)]
    posed = PosedURHand(_model(frame), torch.full((3, 128, 128), 0.3), frame.viewpoint)
    sky, lamp, both = (posed.relight(light).image for light in (*lights, Group(tuple(lights))))
    assert np.abs(sky + lamp - both).max() < 1e-5 * both.max() and lamp.max() > 0.05 * sky.max()
