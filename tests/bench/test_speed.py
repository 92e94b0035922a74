"""`handbench speed`: reading curves off, fits, the reference, the core and its competitors on a tiny scene."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from handbench.light.environment import solid_angles
from handbench.light.lightset import LightSet
from handbench.light.skybox import skybox
from handbench.render.shade.shading import light_features
from handbench.results.origin import Provenance
from handbench.scene import Environment
from handbench.studies.speed import record, study, truth
from handbench.studies.speed.competitors import Naive, bitmap
from handbench.studies.speed.configurations import Configuration
from handbench.studies.speed.core import Core
from handbench.studies.speed.equal_error import Reached, pareto, speed_up, table, time_at
from handbench.studies.speed.measure import ErrorCurve, Trial, timed
from handbench.studies.speed.naive import naive_features
from handbench.studies.speed.scaling import fit
from handbench.studies.speed.scene import Scene, moved, natural_hand, palmar_camera


def points(*pairs: tuple[float, float]) -> tuple[Trial, ...]:
    return tuple(Trial("knob", "", error, (seconds,)) for seconds, error in pairs)


def test_front_drops_what_is_beaten() -> None:
    front = pareto(points((1, 0.1), (2, 0.2), (3, 0.01), (3, 0.02), (4, 0.01)))
    assert [(p.time, p.error) for p in front] == [(1, 0.1), (3, 0.01)]


def test_time_at_an_error_follows_a_power_law_exactly() -> None:
    law = points(*((t, 0.3 * t**-0.5) for t in (1.0, 10.0, 100.0, 1000.0)))
    for error in (0.25, 0.1, 0.03, 0.0101):
        found = time_at(law, error)
        assert found is not None and not found.bound
        assert found.seconds == pytest.approx((0.3 / error) ** 2, rel=1e-9)


def test_nothing_is_extrapolated() -> None:
    law = points((1.0, 0.1), (10.0, 0.01))
    assert time_at(law, 0.009) is None
    assert time_at(law, 0.2) == Reached(1.0, bound=True)
    assert time_at(law, 0.1) == Reached(1.0)
    assert time_at((), 0.1) is None


def test_an_exact_point_can_be_interpolated_to() -> None:
    found = time_at(points((1.0, 0.1), (2.0, 0.0)), 0.01)
    assert found is not None and 1.0 < found.seconds < 2.0


def test_speed_up_says_what_it_knows() -> None:
    assert speed_up(Reached(1.0), Reached(12.0)).times == 12.0
    assert speed_up(Reached(1.0, bound=True), Reached(12.0)).sign == ">="
    assert speed_up(Reached(1.0), Reached(12.0, bound=True)).sign == "<="
    assert speed_up(Reached(1.0, True), Reached(12.0, True)).times is None
    assert speed_up(Reached(1.0), None).reason == "not reached"
    assert speed_up(None, Reached(1.0)).times is None


def test_table_compares_poses_apart() -> None:
    curves = [
        ErrorCurve("ours", "new", points((1.0, 0.1), (2.0, 0.01))),
        ErrorCurve("theirs", "new", points((10.0, 0.1), (80.0, 0.02))),
        ErrorCurve("ours", "known", points((0.1, 0.001))),
        ErrorCurve("theirs", "known", points((5.0, 0.2), (50.0, 0.001))),
    ]
    rows = table(curves, (0.1, 0.01))
    cells = {(row.renderer, row.pose): row.cells for row in rows}
    assert cells["theirs", "new"][0].speed_up == pytest.approx(10.0)
    assert cells["theirs", "new"][1].reason == "not reached"
    assert cells["theirs", "known"][1].sign == ">="
    assert not cells["ours", "new"][0].compared


def test_fit_finds_the_exponent_behind_a_fixed_cost() -> None:
    sizes = [1, 4, 16, 64, 256, 1024, 4096, 16384]
    found = fit(sizes, [0.05 + 1e-3 * size**0.8 for size in sizes])
    assert found.used < len(sizes)
    assert found.exponent == pytest.approx(0.8, abs=0.12)
    exact = fit(sizes, [2e-3 * size**1.5 for size in sizes])
    assert exact.exponent == pytest.approx(1.5, abs=1e-9)
    assert exact.error == pytest.approx(0.0, abs=1e-9)


def test_fit_of_a_flat_curve_uses_three_sizes_and_says_how_sure_it_is() -> None:
    found = fit([1, 2, 4, 8], [1.0, 1.1, 0.9, 1.0])
    assert found.used == 3
    assert abs(found.exponent) < 3 * found.error + 0.2


def test_timed_keeps_every_repeat_and_prepares_off_the_clock() -> None:
    given = []
    seconds, answers = timed(lambda step: given.append(step) or step, lambda step: np.array(step), 3)
    assert given == [0, 1, 2, 3]
    assert len(seconds) == 3
    assert [int(answer) for answer in answers] == [1, 2, 3]


@pytest.mark.parametrize("model", ["brdf", "phong", "diffuse"])
def test_naive_features_are_those_of_the_core(model: str) -> None:
    generator = torch.Generator().manual_seed(0)
    normal = torch.nn.functional.normalize(torch.randn(3, 200, generator=generator).double(), dim=0)
    position = 0.1 * torch.rand(3, 200, generator=generator).double()
    rough = torch.rand(200, generator=generator).double()
    rng = np.random.default_rng(0)
    towards = rng.normal(size=(9, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    lights = LightSet(towards, rng.random((9, 3)), rng.normal(size=(4, 3)), rng.random((4, 3)))
    seen = torch.rand(13, 200, generator=generator).double()
    arguments = (normal, position, rough, np.array([0.0, 0.0, 1.0]), lights, seen, model)
    for naive, core in zip(naive_features(*arguments), light_features(*arguments), strict=True):
        torch.testing.assert_close(naive, core, rtol=1e-7, atol=1e-7 * float(core.abs().max()))


def test_naive_features_are_finite_where_light_and_viewer_are_opposite() -> None:
    normal = torch.tensor([[0.0], [0.0], [1.0]])
    lights = LightSet(np.array([[0.0, 0.0, -1.0]]), np.ones((1, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
    found = naive_features(normal, torch.zeros(3, 1), torch.zeros(1), np.array([0.0, 0.0, 1.0]), lights)
    assert all(feature.isfinite().all() for feature in found)


def test_strata_carry_the_power_of_the_map() -> None:
    sky = skybox("brightday", 8, 16)
    share = truth.texel_shares(sky, 600)
    towards, power = truth.stratified(sky, share, np.random.default_rng(0))
    expected = (sky.radiance.astype(np.float64) * solid_angles(8, 16)[..., None]).sum(axis=(0, 1))
    np.testing.assert_allclose(power.sum(axis=0), expected, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(towards, axis=1), 1.0)
    assert share.max() > 4 * share.min()  # the sun gets more directions


def test_the_map_given_to_mitsuba_has_ramps_that_lie_evenly_about_borders() -> None:
    fine = bitmap(Environment("two", np.array([[[1.0] * 3], [[3.0] * 3]])))
    assert fine.shape == (17, 8, 3)
    np.testing.assert_array_equal(fine[:, 0, 0], [1.0] * 8 + [2.0] + [3.0] * 8)


@pytest.fixture(scope="module")
def tiny() -> Scene:
    albedo = np.array([0.6, 0.5, 0.4])
    return Scene("tiny", "Tiny", natural_hand(1), palmar_camera(36, 48), skybox("hall", 4, 8), albedo)


@pytest.fixture(scope="module")
def expected(tiny: Scene) -> truth.Truth:
    return truth.compute(tiny, 128, 2)


def test_core_and_naive_converge_to_the_reference(tiny: Scene, expected: truth.Truth) -> None:
    assert expected.noise < 0.02
    core = Core(tiny, Configuration(texture=128, lights=(8, 16), supersample=3))
    new = core.new_pose(tiny.mesh)
    assert expected.error(new) < 0.02
    assert expected.error(core.learn(tiny.mesh).picture(tiny.environment)) < 0.02
    assert expected.error(Naive(tiny, 128, (8, 16)).new_pose(tiny.mesh)) < 0.03
    coarse = Core(tiny, Configuration(texture=32, lights=2))
    assert expected.error(coarse.new_pose(tiny.mesh)) > 2 * expected.error(new)


def test_known_pose_draws_what_a_new_one_does_under_any_map(tiny: Scene) -> None:
    core = Core(tiny, Configuration(texture=64, lights=(4, 8)))
    known = core.learn(tiny.mesh)
    other = replace(tiny, environment=skybox("park", 4, 8))
    np.testing.assert_allclose(
        known.picture(other.environment), Core(other, core.configuration).new_pose(tiny.mesh), rtol=1e-4, atol=1e-5
    )


def test_skips_do_not_change_the_picture(tiny: Scene) -> None:
    settings = Configuration(texture=64, lights=16)
    with_skips, without = (Core(tiny, replace(settings, skips=on)).new_pose(tiny.mesh) for on in (True, False))
    np.testing.assert_allclose(with_skips, without, rtol=1e-5, atol=1e-6)


def test_brdf_scene_agrees_with_the_printed_equations(tiny: Scene) -> None:
    glossy = replace(tiny, roughness=0.5)
    reference = truth.compute(glossy, 128, 2)
    core = Core(glossy, Configuration(texture=128, lights=(8, 16), supersample=3))
    assert reference.error(core.new_pose(glossy.mesh)) < 0.03
    assert reference.error(core.learn(glossy.mesh).picture(glossy.environment)) < 0.03
    assert reference.error(Core(tiny, core.configuration).new_pose(tiny.mesh)) > 0.05  # the lobe counts


def test_reference_is_kept_on_disk(tiny: Scene, tmp_path: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = truth.truth(tiny, 32, 2)
    monkeypatch.setattr(truth, "compute", None)
    np.testing.assert_array_equal(truth.truth(tiny, 32, 2).values, first.values)
    with pytest.raises(TypeError):  # another scene is computed anew
        truth.truth(replace(tiny, albedo=tiny.albedo / 2), 32, 2)


def test_moved_is_another_mesh_with_the_same_picture(tiny: Scene, expected: truth.Truth) -> None:
    core = Core(tiny, Configuration(texture=64, lights=16))
    a, b = (core.new_pose(mesh).reshape(-1, 3)[expected.pixels] for mesh in (tiny.mesh, moved(tiny.mesh, 7)))
    assert 0 < truth.relative_rmse(b, a) < 2e-3


def test_a_study_of_a_scene_is_whole_json(tiny: Scene, tmp_path: object, monkeypatch: pytest.MonkeyPatch) -> None:
    from pathlib import Path

    few = [("lights", Configuration(texture=32, lights=n)) for n in (2, 8)]
    grid = [("grid", Configuration(texture=32, lights=(4, 8)))]
    monkeypatch.setattr(study, "new_pose_sweep", lambda quick: few)
    monkeypatch.setattr(study, "known_pose_sweep", lambda quick: grid)
    monkeypatch.setattr(study, "_naive", lambda *arguments: [])
    monkeypatch.setattr(study.truth, "truth", lambda scene, *rest: truth.compute(scene, 64, 2))
    found = study.of_scene(replace(tiny, roughness=0.5), quick=True)
    assert {curve.pose for curve in found.curves} == {"new", "known"}
    assert all(len(p.seconds) >= 3 for curve in found.curves for p in curve.points)
    folder = Path(str(tmp_path)) / "out"
    whole = record.SpeedRecord(True, Provenance("0", None, "handbench speed"), (found,), study.GOALS, (), ())
    record.write(folder, whole)
    assert record.read(folder) == whole
    assert [path.name for path in folder.iterdir()] == ["speed.json"]
    assert math.isfinite(found.truth.noise)
