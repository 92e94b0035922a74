"""`handbench speed` of implicit hands: its parts on tiny sizes, held to what must be true of them."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from handbench.methods.palm.model import PalmModel
from handbench.studies.speed import fields, gathering
from handbench.studies.speed.fields import DistanceSamples
from handbench.studies.speed.volume import GOALS, PLAIN, SWITCHES, TOGETHER, PersonView, skipped, textured

SMALL = replace(fields.VARIANTS["dense grids and tri-plane"], grids=(8, 16), plane=32, geometry=(32,))


@pytest.fixture(scope="module")
def skin() -> DistanceSamples:
    return DistanceSamples.of_neutral()


@pytest.fixture(scope="module")
def model(skin: DistanceSamples) -> PalmModel:
    return textured(fields.learned("small", SMALL, skin, 60)[0])


def test_errors_of_an_encoding_are_those_of_its_model(skin: DistanceSamples) -> None:
    made, part = fields.learned("small", SMALL, skin, 16)
    assert [point.size for point in part.points] == [2, 4, 8, 16]
    assert part.points[-1].error < 0.7 * part.points[0].error
    assert [p.seconds for p in part.points] == sorted(p.seconds for p in part.points)
    with torch.no_grad():
        found = made.geometry(skin.places[skin.near], fields.conditions(made)).sdf
    error = 1e3 * float((found - skin.distances[skin.near]).abs().mean())
    assert part.points[-1].error == pytest.approx(error, rel=0.05)


def test_places_near_the_skin_are_near(skin: DistanceSamples) -> None:
    _, distances = skin.some(500, torch.Generator().manual_seed(0))
    assert distances.abs().max() < fields.REACH
    _, distances = skin.some(0, torch.Generator().manual_seed(0), 500)
    assert distances.abs().max() > 2 * fields.REACH


def test_skips_save_time_and_change_little(model: PalmModel) -> None:
    found = {one.label: one for one in skipped(PersonView.of(model, 32))}
    assert set(found) == {"all skips", *(f"without {name}" for name in SWITCHES), TOGETHER, PLAIN}
    assert found["all skips"].error == 0.0 and found["without outside_box"].error < 1e-6
    assert all(one.error < 0.1 for one in found.values())
    assert found[PLAIN].seconds > 3 * found["all skips"].seconds
    assert {label: one.goal for label, one in found.items() if one.goal} == GOALS


def test_a_picture_shows_the_hand_in_the_middle(model: PalmModel) -> None:
    _, colours = PersonView.of(model, 32).drawn()
    seen = (colours.sum(dim=1) > 0.1).view(32, 24)
    assert seen[8:24, 6:18].float().mean() > 0.4
    assert not seen[0].any() and not seen[:, 0].any() and not seen[:, -1].any()


def test_another_configuration_leaves_the_model_as_it_was(model: PalmModel) -> None:
    view = PersonView.of(model, 16)
    few = view.drawn(config=replace(model.config, samples=2))[1]
    assert not torch.equal(few, view.drawn()[1])
    assert view.posed.model is model and model.config.samples == SMALL.samples


def test_more_directions_err_less_and_lights_least() -> None:
    found = {part.name: part for part in gathering.gathered(12, 1)}
    assert len(found) == 2 * 6
    for title in gathering.MAPS.values():
        best = found[f"{title}: light importance, one set"].points
        assert best[-1].error < best[0].error
        assert found[f"{title}: distant lights"].points[0].error < 0.03
