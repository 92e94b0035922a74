"""Kept shadows: the same as fresh ones, in memory and on disk, and never those of another light, kind or skip."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from handbench.hand.openhand import OpenHand, named_pose
from handbench.light.lightset import LightSet, light_samples
from handbench.light.stage import stage_directions
from handbench.render.see.shadowmap import soft_visibility
from handbench.render.see.shadowstore import kept_on_disk
from handbench.render.see.visibility import visibility
from handbench.render.uv.posed import PosedSurface
from handbench.scene import Directional, Group, Mesh, Point
from handbench.skips import Saved, Skips, skipping, tallied


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    hand = OpenHand.load()
    return hand.mesh(hand.neutral(), named_pose("fist"), 1)


def _fresh(mesh: Mesh, posed: PosedSurface, lights: LightSet) -> np.ndarray:
    return visibility(mesh, posed.atlas, lights.directions, lights.positions)


def test_kept_shadows_are_the_fresh_ones_in_any_order(mesh: Mesh) -> None:
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(5, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    posed = PosedSurface(mesh, 64)
    for order in ([0, 1, 2], [4, 2, 0, 3], [1]):
        lights = light_samples(Group(tuple(Directional(directions[i], np.ones(3)) for i in order)))
        assert np.array_equal(posed.visibility(lights).numpy(), _fresh(mesh, posed, lights))


def test_a_near_light_is_not_taken_for_a_distant_one(mesh: Mesh) -> None:
    posed = PosedSurface(mesh, 64)
    distant, near = (light_samples(light) for light in (Directional([0, 0, 1], [1] * 3), Point([0, 0, 1], [1] * 3)))
    posed.visibility(distant)
    assert np.array_equal(posed.visibility(near).numpy(), _fresh(mesh, posed, near))


def test_darkness_has_no_rows(mesh: Mesh) -> None:
    assert PosedSurface(mesh, 64).visibility(light_samples(Group(()))).shape[0] == 0
    assert PosedSurface(mesh, 64).visibility(light_samples(Group(())), soft=True).shape[0] == 0


LIGHTS = light_samples(
    Group((Directional([0, 0, 1], [1] * 3), Directional([0.6, 0, 0.8], [1] * 3), Point([0, 0.3, 0.4], [1] * 3)))
)


@pytest.fixture
def traced(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many lights each call traced."""
    calls: list[int] = []

    whole = PosedSurface._traced

    def counted(self, names, wanted):
        calls.append(len(names))
        return whole(self, names, wanted)

    monkeypatch.setattr(PosedSurface, "_traced", counted)
    return calls


def test_soft_shadows_are_kept_as_bytes(mesh: Mesh, traced: list[int]) -> None:
    posed = PosedSurface(mesh, 48)
    exact = soft_visibility(mesh, posed.atlas, LIGHTS.directions, LIGHTS.positions)
    for _ in range(2):
        kept = posed.visibility(LIGHTS, soft=True)
        assert kept.dtype == torch.float32
        assert np.abs(kept.numpy() - exact).max() <= 1 / 510 + 1e-7
    assert posed.visibility(LIGHTS).dtype == torch.bool, "hard ones are not taken for soft ones"
    assert np.array_equal(posed.visibility(LIGHTS).numpy(), _fresh(mesh, posed, LIGHTS))
    assert traced == [3, 3]


def test_what_is_known_is_counted(mesh: Mesh) -> None:
    posed = PosedSurface(mesh, 32)
    pairs = 3 * posed.atlas.count
    with tallied() as tally:
        posed.visibility(LIGHTS)
        assert tally.lines()["shadows known already"] == Saved(pairs, 0)
        traced = tally.lines()["shadow rays"]
        posed.visibility(LIGHTS)
    assert traced.total == pairs and pairs / 4 < traced.skipped < pairs
    assert tally.lines() == {"shadows known already": Saved(2 * pairs, pairs), "shadow rays": traced}


@pytest.mark.parametrize("soft", [False, True])
def test_disk_gives_back_what_was_traced(mesh: Mesh, tmp_path: Path, traced: list[int], soft: bool) -> None:
    first = PosedSurface(mesh, 48).visibility(LIGHTS, soft)
    with kept_on_disk(tmp_path, 1 << 20):
        for _ in range(3):  # like three processes: their memory is not shared
            assert torch.equal(PosedSurface(mesh, 48).visibility(LIGHTS, soft), first)
        assert traced == [3, 3]
        turned = Mesh(mesh.vertices[:, [1, 2, 0]], mesh.topology)
        for other in (PosedSurface(mesh, 47), PosedSurface(turned, 48)):  # other content
            expected = (soft_visibility if soft else visibility)(
                other.mesh, other.atlas, LIGHTS.directions, LIGHTS.positions
            )
            assert np.abs(other.visibility(LIGHTS, soft).numpy() - expected.astype(float)).max() <= 1 / 510 + 1e-7
        PosedSurface(mesh, 48).visibility(LIGHTS, not soft)
        assert traced == [3, 3, 3, 3, 3]
    PosedSurface(mesh, 48).visibility(LIGHTS, soft)
    assert traced == [3, 3, 3, 3, 3, 3], "off outside of the block"


def test_disk_knows_some_lights_and_the_others_are_traced(mesh: Mesh, tmp_path: Path, traced: list[int]) -> None:
    some = light_samples(Group((Directional([0.6, 0, 0.8], [1] * 3), Directional([0, 1, 0], [1] * 3))))
    with kept_on_disk(tmp_path, 1 << 20):
        PosedSurface(mesh, 48).visibility(LIGHTS)
        posed = PosedSurface(mesh, 48)
        assert np.array_equal(posed.visibility(some).numpy(), _fresh(mesh, posed, some))
    assert traced == [3, 1]


def test_without_the_skip_nothing_known_is_used(mesh: Mesh, tmp_path: Path, traced: list[int]) -> None:
    with kept_on_disk(tmp_path, 1 << 20), skipping(Skips(known=False)), tallied() as tally:
        posed = PosedSurface(mesh, 32)
        first = posed.visibility(LIGHTS)
        assert torch.equal(posed.visibility(LIGHTS), first)
    assert traced == [3, 3] and not list(tmp_path.iterdir())
    assert "shadows known already" not in tally.lines()


def test_shadows_of_other_skips_are_not_taken(mesh: Mesh, tmp_path: Path) -> None:
    posed = PosedSurface(mesh, 48)
    with kept_on_disk(tmp_path, 1 << 20):
        posed.visibility(LIGHTS)
        for surface in (posed, PosedSurface(mesh, 48)):
            with skipping(Skips(below_horizon=False)):
                assert np.array_equal(surface.visibility(LIGHTS).numpy(), _fresh(mesh, surface, LIGHTS))


@pytest.mark.parametrize("soft", [False, True])
def test_some_texels_see_what_they_see_among_all(mesh: Mesh, tmp_path: Path, traced: list[int], soft: bool) -> None:
    posed = PosedSurface(mesh, 48)
    everything = posed.visibility(LIGHTS, soft)
    some, others = np.arange(0, posed.atlas.count, 3), np.arange(1, posed.atlas.count, 3)
    with kept_on_disk(tmp_path, 1 << 20):
        for surface in (posed, PosedSurface(mesh, 48)):
            for texels in (some, others, some):
                assert torch.equal(surface.visibility(LIGHTS, soft, texels), everything[:, texels])
    assert posed.visibility(LIGHTS, soft, some[:0]).shape == (3, 0)
    assert traced == [3, 3, 3, 3]


def test_coarse_lights_are_filled_in_and_others_are_not(mesh: Mesh, tmp_path: Path) -> None:
    towards = stage_directions(30)
    coarse = np.arange(30) < 20
    lights = LightSet(towards, np.ones((30, 3)), np.zeros((0, 3)), np.zeros((0, 3)), coarse=coarse)
    exact = visibility(mesh, PosedSurface(mesh, 64).atlas, towards)
    with kept_on_disk(tmp_path, 1 << 20):
        posed = PosedSurface(mesh, 64)
        seen = posed.visibility(lights).numpy()
        assert np.array_equal(seen[~coarse], exact[~coarse]) and 0.0 < (seen[coarse] != exact[coarse]).mean() < 0.02
        sharp = LightSet(towards, np.ones((30, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
        for surface in (posed, PosedSurface(mesh, 64)):  # filled shadows are never taken for traced ones
            assert np.array_equal(surface.visibility(sharp).numpy(), exact)
            assert np.array_equal(surface.visibility(lights).numpy(), seen)
