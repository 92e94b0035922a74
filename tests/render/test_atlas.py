from __future__ import annotations

import numpy as np
import pytest
import torch

from handbench.errors import InputError
from handbench.render.uv.atlas import Atlas
from handbench.scene import Topology


def test_texels_lie_where_their_centres_are(shapes) -> None:
    mesh = shapes.plane(size=1.0, cells=5, box=(0.0, 0.0, 1.0, 1.0))  # u = x + 1/2, v = 1/2 - z
    atlas = Atlas(mesh.topology, 16)
    assert atlas.covered.all() and atlas.count == 256
    texture = atlas.scatter(torch.from_numpy(atlas.interpolate(mesh.vertices).T))
    centre = (np.arange(16) + 0.5) / 16
    u, v = np.meshgrid(centre, 1 - centre)  # row 0 is the top, v near 1
    assert np.allclose(texture[0], u - 0.5, atol=1e-6)
    assert np.allclose(texture[2], 0.5 - v, atol=1e-6)
    assert np.allclose(atlas.barycentric.sum(axis=1), 1, atol=1e-6)


def test_coverage_is_the_area_of_the_charts() -> None:
    # a triangle with its diagonal from corner to corner covers half the square
    triangle = Topology([[0, 1, 2]], [[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])
    atlas = Atlas(triangle, 64)
    assert atlas.covered.mean() == pytest.approx(0.5, abs=1 / 64)
    assert atlas.covered[-1, 0] and atlas.covered[0, 0] and not atlas.covered[0, -1]


def test_gather_and_scatter_are_inverse(shapes) -> None:
    atlas = Atlas(shapes.sphere(8, 16).topology, 32)
    assert 0 < atlas.count < 32 * 32
    values = torch.rand(2, 3, atlas.count)
    texture = atlas.scatter(values)
    assert texture.shape == (2, 3, 32, 32)
    assert torch.equal(atlas.gather(texture), values)
    assert not texture[..., ~torch.from_numpy(atlas.covered)].any()


def test_dilation_takes_the_nearest_covered_texel(shapes) -> None:
    mesh = shapes.plane(box=(0.25, 0.25, 0.75, 0.75))
    atlas = Atlas(mesh.topology, 16)
    texture = atlas.scatter(torch.arange(atlas.count, dtype=torch.float32) + 1)
    filled = atlas.dilate(texture)
    assert torch.equal(atlas.gather(filled), atlas.gather(texture))
    assert (filled > 0).all() and filled[0, 0] == texture[4, 4] and filled[15, 6] == texture[11, 6]
    near = atlas.dilate(texture, texels=2)
    assert near[2, 6] == texture[4, 6] and near[1, 6] == 0


def test_charts_are_the_islands(shapes) -> None:
    mesh = shapes.join(shapes.plane(box=(0.0, 0.0, 0.5, 1.0)), shapes.plane(box=(0.5, 0.0, 1.0, 1.0)))
    atlas = Atlas(mesh.topology, 8)
    chart = atlas.scatter(torch.from_numpy(atlas.chart))
    assert len(set(atlas.chart.tolist())) == 2
    assert (chart[:, :4] == chart[0, 0]).all() and (chart[:, 4:] == chart[0, 7]).all()


def test_atlases_are_kept_by_topology(shapes) -> None:
    topology = shapes.plane().topology
    assert Atlas.of(topology, 8) is Atlas.of(topology, 8)
    assert Atlas.of(topology, 8) is not Atlas.of(topology, 16)
    assert Atlas.of(topology, 8) is Atlas.of(shapes.plane().topology, 8), "by its content, not its identity"
    assert Atlas.of(topology, 8) is not Atlas.of(shapes.plane(cells=3).topology, 8)


def test_useless_atlases_are_refused(shapes) -> None:
    with pytest.raises(InputError, match="at least 1"):
        Atlas(shapes.plane().topology, 0)
    with pytest.raises(InputError, match="no texel"):
        Atlas(Topology([[0, 1, 2]], [[0.5, 0.5], [0.51, 0.5], [0.5, 0.51]], [[0, 1, 2]]), 8)
