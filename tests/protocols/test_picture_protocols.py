"""Protocols of avatars from pictures fit their captures, tell methods no more than they say, and hide the light."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest

from handbench.bench import given
from handbench.bench.opening import select
from handbench.bench.plan import make_method
from handbench.bench.protocol import Protocol
from handbench.bench.resolving import Selected
from handbench.data.openstage import open_capture
from handbench.data.openstage.population import PEOPLE, cast
from handbench.data.openstage.presets import preset
from handbench.data.together import Together
from handbench.hand.openhand import OpenHand
from handbench.protocols import parse
from handbench.registry import METHODS, PROTOCOLS
from handbench.scene import Environment, Point, Unknown

FOLDER = Path(__file__).parents[2] / "protocols"
FEW = {"phone": ["s97", "s98"], "wild": ["s73", "s74"], "palm-main": ["s73", "s74"]}
TAUGHT = {"openstage": ["s01", "s02"], "openscans": ["s25", "s26"]}


def smallest(name: str) -> Protocol:
    """The protocol on the smallest sizes of its captures, with the people that those have."""
    table: dict[str, Any] = tomllib.loads((FOLDER / f"{name}.toml").read_text())
    table["size"] = table["train"]["size"] = "mini"
    if "lightings" in table["train"]:
        table["train"]["lightings"] = ["olat-0[0-5]", "group-*", "full"]
    table["subjects"] = {"trained": TAUGHT[table["train"]["capture"]], "unseen": FEW[name]}
    for column in table["column"]:
        if isinstance(column["subjects"], list):
            column["subjects"] = [subject for subject in column["subjects"] if subject in FEW[name]]
    return parse(table, name)


@pytest.fixture(scope="module", params=sorted(FEW))
def selected(request: pytest.FixtureRequest) -> Selected:
    protocol = smallest(request.param)
    assert protocol.trains_on is not None
    parts = (open_capture("mini", capture=name) for name in (protocol.capture, protocol.trains_on[0]))
    return select(protocol, Together(*parts))


def test_training_shows_other_people_and_enrolment_the_pictures(selected: Selected) -> None:
    assert selected.protocol.trains_on is not None
    assert {frame.subject for frame in selected.train} == set(TAUGHT[selected.protocol.trains_on[0]])
    for subject in selected.protocol.subjects:
        seen = [frame for frame in selected.enrol if frame.subject == subject]
        assert {frame.segment for frame in seen} == {"scan" if selected.protocol.name == "phone" else "sequence"}
        assert len(seen) == (4 if selected.protocol.name == "phone" else 1)


@pytest.mark.parametrize("method", ["mean-phone", "sh-phone", "urhand-phone", "palm-net"])
def test_methods_see_no_light_no_mesh_and_at_most_an_estimated_pose(selected: Selected, method: str) -> None:
    info = make_method(METHODS.entry(method), "quick").info
    if selected.protocol.name == "palm-main" and method in ("sh-phone", "urhand-phone"):
        assert "trains on tracked meshes" in (given.refusal(selected, info, selected.protocol.subjects[0]) or "")
        return
    for subject in selected.protocol.subjects:
        assert given.refusal(selected, info, subject) is None
        seen = given.enrolment(selected, info, subject, lambda frame: pytest.fail("not read"))
        for frame in seen.frames:
            assert isinstance(frame.light, Unknown) and frame.mesh is frame.shape is None
            assert (frame.pose is None) == (selected.protocol.name == "phone")
    label = "phone scan" if selected.protocol.name == "phone" else "one picture"
    assert given.enrolled_with(selected, info) == label


@pytest.mark.parametrize("method", ["physical", "urhand", "mean", "relightablehands"])
def test_methods_that_need_the_stage_are_refused(selected: Selected, method: str) -> None:
    info = make_method(METHODS.entry(method), "quick").info
    refusal = given.refusal(selected, info, selected.protocol.subjects[0]) or ""
    assert "needs" in refusal or "trains on" in refusal


def test_queries_bring_a_pose_and_only_lights_that_are_told(selected: Selected) -> None:
    info = make_method(METHODS.entry("sh-phone"), "quick").info
    for column in selected.protocol.columns:
        for frame in selected.scored[column.name]:
            asked = given.asked(selected, info, frame)
            assert asked.pose is not None and asked.mesh is None
            kind = Unknown if column.light == "as enrolled" else Point if "lamp" in column.name else Environment
            assert isinstance(asked.light, kind)


@pytest.mark.parametrize("name", sorted(FEW))
def test_scored_people_are_those_of_the_capture_and_tones_are_what_columns_say(name: str) -> None:
    protocol = PROTOCOLS.load(name)
    count = preset(protocol.size, protocol.capture).subjects
    people = {person.name: person for person in cast(protocol.capture, count, OpenHand.load())}
    assert set(protocol.unseen) == set(people) and count <= len(PEOPLE[protocol.capture])
    for column in protocol.columns:
        if isinstance(column.subjects, tuple):
            dark = [people[subject].look.melanin > 0.8 for subject in column.subjects]
            assert all(dark) if column.name.endswith("dark") else not any(dark)
