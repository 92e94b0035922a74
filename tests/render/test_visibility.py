from __future__ import annotations

import numpy as np
import pytest
import torch

from handbench.light.stage import stage_directions
from handbench.render.see.posedmesh import PosedMesh
from handbench.render.see.rays import RayScene
from handbench.render.see.visibility import HORIZON, HardShadows, around_texels, visibility
from handbench.render.uv.atlas import Atlas
from handbench.render.uv.surface import surface_maps
from handbench.skips import NONE, Skips, skipping, tallied


def flat(mesh, atlas):
    maps = surface_maps(mesh, atlas)
    return atlas.gather(maps.position).T.double().numpy(), atlas.gather(maps.normal).T.double().numpy()


def test_rays_hit_where_they_should(shapes) -> None:
    scene = RayScene(*(lambda m: (m.vertices, m.topology.faces))(shapes.sphere(64, 128, radius=2.0)))
    origins = np.array([[0, 0, 5.0], [0.5, 0.3, 5.0], [3, 3, 5.0]])
    hits = scene.cast(origins, np.array([[0, 0, -2.0]]))
    assert hits.hit.tolist() == [True, True, False]
    assert hits.distance[0] == pytest.approx(1.5, abs=2e-3)  # in units of the direction
    assert np.allclose(hits.barycentric[:2].sum(axis=1), 1)
    mesh = shapes.sphere(64, 128, radius=2.0)
    point = np.einsum("nk,nkc->nc", hits.barycentric[:2], mesh.vertices[mesh.topology.faces[hits.face[:2]]])
    assert np.allclose(point, origins[:2] + hits.distance[:2, None] * [0, 0, -2.0], atol=1e-5)
    assert scene.occluded(origins, np.array([[0, 0, -1.0]])).tolist() == [True, True, False]
    assert not scene.occluded(origins, np.array([[0, 0, -1.0]]), far=2.0).any()


def test_a_scene_without_faces_blocks_nothing() -> None:
    scene = RayScene(np.zeros((0, 3)), np.zeros((0, 3), dtype=int))
    assert not scene.occluded(np.zeros((2, 3)), np.ones((2, 3))).any()


@pytest.mark.parametrize("cells", [(12, 24), (48, 96)])
def test_a_ball_has_no_shadow_on_its_lit_side(shapes, cells: tuple[int, int]) -> None:
    # also on coarse meshes, where the flat triangles would hide each other along the terminator
    mesh = shapes.sphere(*cells, radius=0.1, centre=(0.3, 1.0, -0.2))
    atlas = Atlas(mesh.topology, 64)
    _, normal = flat(mesh, atlas)
    lights = stage_directions(40)
    with skipping(NONE):
        seen = visibility(mesh, atlas, lights)
    cosine = lights @ normal.T
    assert seen.shape == cosine.shape and seen.dtype == bool
    assert seen[cosine > 0].all()
    # starts on the smooth ball look over the horizon of the flat triangles by sqrt(2 sagitta / radius), no more
    assert not seen[cosine < -np.sqrt(2 * (1 - np.cos(np.pi / cells[0])))].any()


@pytest.mark.parametrize("light", [(0.0, 1.0, 0.0), (0.5, 0.8, -0.2), (-0.7, 0.5, 0.4)])
def test_the_shadow_of_a_ball_is_an_ellipse(shapes, light: tuple[float, float, float]) -> None:
    light = np.array(light) / np.linalg.norm(light)
    ball = shapes.sphere(96, 192, radius=0.2, centre=(0, 0.4, 0), box=(0.0, 0.0, 0.2, 0.2))
    mesh = shapes.join(shapes.plane(2.0, box=(0.25, 0.25, 1.0, 1.0)), ball)
    atlas = Atlas(mesh.topology, 256)
    position, _ = flat(mesh, atlas)
    seen = visibility(mesh, atlas, light[None])[0]
    floor = np.abs(position[:, 1]) < 1e-6
    towards = np.array([0, 0.4, 0]) - position
    distance = np.linalg.norm(np.cross(towards, light), axis=1)
    assert 100 < (~seen[floor]).sum() < floor.sum() / 2
    assert seen[floor & (distance > 0.201)].all()
    assert not seen[floor & (distance < 0.199)].any()


def test_a_near_light_casts_a_cone_and_ignores_what_lies_beyond(shapes) -> None:
    ball = shapes.sphere(96, 192, radius=0.2, centre=(0, 0.4, 0), box=(0.0, 0.0, 0.2, 0.2))
    roof = shapes.plane(4.0, height=3.0, box=(0.0, 0.25, 0.2, 0.4))
    mesh = shapes.join(shapes.plane(2.0, box=(0.25, 0.25, 1.0, 1.0)), ball, roof)
    atlas = Atlas(mesh.topology, 256)
    position, _ = flat(mesh, atlas)
    lamp = np.array([0.3, 1.5, 0.1])
    seen = visibility(mesh, atlas, np.zeros((0, 3)), lamp[None])[0]
    towards = lamp - position
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    distance = np.linalg.norm(np.cross(np.array([0, 0.4, 0]) - position, towards), axis=1)
    floor = np.abs(position[:, 1]) < 1e-6
    assert (~seen[floor]).sum() > 100
    assert seen[floor & (distance > 0.201)].all() and not seen[floor & (distance < 0.199)].any()
    # a distant light from above is held off by the roof
    assert not visibility(mesh, atlas, np.array([[0.0, 1.0, 0.0]]))[0, floor].any()


def test_near_lights_far_away_see_as_distant_ones(shapes) -> None:
    mesh = shapes.torus()
    atlas = Atlas(mesh.topology, 64)
    lights = stage_directions(7)
    both = visibility(mesh, atlas, lights, 1e3 * lights)
    assert both.shape == (14, atlas.count)
    assert (both[:7] == both[7:]).mean() > 0.995
    assert 0.2 < both.mean() < 0.5


def test_pairs_below_the_horizon_are_skipped_and_counted(shapes) -> None:
    mesh = shapes.torus()
    atlas = Atlas(mesh.topology, 48)
    lights, lamps = stage_directions(30), 5.0 * stage_directions(3)
    _, normal = flat(mesh, atlas)
    cosine = lights @ normal.T
    with tallied() as tally:
        some = visibility(mesh, atlas, lights, lamps)
    with skipping(Skips(below_horizon=False)), tallied() as whole_tally:
        everything = visibility(mesh, atlas, lights, lamps)
    saved, nothing = tally.lines()["shadow rays"], whole_tally.lines()["shadow rays"]
    assert nothing.total == saved.total == everything.size and nothing.skipped == 0
    assert (cosine <= -HORIZON).mean() <= saved.skipped / saved.total <= (cosine <= 0).mean() + 0.01
    assert np.array_equal(some[:30][cosine > 0], everything[:30][cosine > 0])
    # what is left out lies in shadow anyway, up to a thin band that lifted starts see over the horizon
    missed = everything & ~some
    assert not some[:30][cosine <= -HORIZON].any()
    assert missed[:30][cosine <= 0].mean() < 1e-3


def test_batches_of_rays_do_not_change_the_answer(shapes, monkeypatch: pytest.MonkeyPatch) -> None:
    import handbench.render.see.visibility as module

    mesh = shapes.torus(24, 48)
    atlas = Atlas(mesh.topology, 32)
    lights = stage_directions(11)
    whole = visibility(mesh, atlas, lights)
    monkeypatch.setattr(module, "_RAYS", 1)
    assert np.array_equal(visibility(mesh, atlas, lights), whole)
    assert torch.from_numpy(whole).dtype == torch.bool


def test_shadows_that_are_filled_in_are_those_that_are_traced_but_for_edges(shapes) -> None:
    ball = shapes.sphere(48, 96, radius=0.2, centre=(0, 0.4, 0), box=(0.0, 0.0, 0.25, 0.25))
    mesh = PosedMesh(shapes.join(shapes.plane(2.0, box=(0.3, 0.3, 1.0, 1.0)), ball))
    atlas = Atlas(mesh.topology, 128)
    lights = stage_directions(40)
    shadows = HardShadows(mesh, atlas)
    whole = shadows.visible(lights)
    with tallied() as filled_tally:
        filled = shadows.visible(lights, fill=True)
    with tallied() as whole_tally, skipping(Skips(agreed=False)):
        assert np.array_equal(shadows.visible(lights, fill=True), whole)
    assert 0.0 < (filled != whole).mean() < 2e-3
    rays = [t.lines()["shadow rays"].total - t.lines()["shadow rays"].skipped for t in (filled_tally, whole_tally)]
    assert rays[0] < 0.5 * rays[1]
    for share in (0.8, 0.01):
        some = np.flatnonzero(np.random.default_rng(0).random(atlas.count) < share)
        assert np.array_equal(shadows.visible(lights, None, some, fill=True), filled[:, some]), (
            "whichever are asked for"
        )


@pytest.mark.parametrize("step", [2, 4])
def test_texels_between_others_are_in_the_middle_of_them(shapes, step: int) -> None:
    atlas = Atlas(shapes.join(shapes.plane(1.0, box=(0.0, 0.0, 0.45, 1.0)), shapes.plane(1.0, box=(0.5, 0.0, 1.0, 1.0)))
                  .topology, 33)  # fmt: skip
    between, around = around_texels(atlas, step)
    place = np.stack(np.divmod(atlas.texels, atlas.size))
    assert len(between) > 0.3 * atlas.count / (step / 2) ** 2
    assert np.array_equal(place[:, around].mean(axis=1), place[:, between])
    assert (place[:, around] % step == 0).all()
    assert np.abs(place[:, around] - place[:, None, between]).max() == step // 2
    assert (atlas.chart[around] == atlas.chart[between]).all()
