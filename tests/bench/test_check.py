"""Each law has a method that breaks it alone."""

from __future__ import annotations

import pytest

from handbench.bench.check import check
from handbench.errors import InputError, NonFinite


def verdicts(name, protocol):
    return {verdict.law: verdict for verdict in check(name, protocol)}


def test_a_lawful_method(fakes, toy_protocol):
    found = verdicts("toy", toy_protocol())
    assert [verdict.holds for verdict in found.values()] == [True] * 6
    assert "10 of 10 queries drawn" in found["finite"].detail


@pytest.mark.parametrize(
    ("name", "broken"),
    [
        ("toy-nan", {"finite"}),
        ("toy-mutates", {"no mutation"}),
        ("toy-unseeded", {"same seed"}),
        ("toy-lossy", {"round trip"}),
        ("toy-square", {"linear"}),
    ],
)
def test_a_broken_law_is_named(fakes, toy_protocol, name, broken):
    found = verdicts(name, toy_protocol())
    assert {law for law, verdict in found.items() if verdict.holds is False} == broken


def test_an_answer_that_depends_on_what_was_asked_before_is_a_mutation(fakes, toy_protocol):
    found = verdicts("toy-forgetful", toy_protocol())
    assert found["no mutation"].holds is False


def test_linearity_is_measured_where_it_is_not_declared(fakes, toy_protocol):
    found = verdicts("toy-lossy", toy_protocol())
    assert found["linear"].holds is None and "not declared; largest deviation" in found["linear"].detail


def test_the_oracle_and_what_is_unsupported(fakes, toy_protocol):
    assert verdicts("oracle", toy_protocol())["linear"].holds is None
    assert "8 of 10 queries drawn" in verdicts("toy-no-environment", toy_protocol())["finite"].detail


def test_a_method_that_cannot_train(fakes, toy_protocol):
    (verdict,) = verdicts("toy-crash-train", toy_protocol()).values()
    assert verdict.holds is False and "no such layer" in verdict.detail


def test_what_the_user_can_mend_breaks_no_law(fakes, toy_protocol, capsys):
    with pytest.raises(InputError, match="no subject 's09'"):
        check("toy", toy_protocol(subjects={"trained": ["s09"], "unseen": ["s02"]}))
    assert "capture toy tiny 1/1" in capsys.readouterr().err, "generating a capture is told"
    with pytest.raises(InputError, match=r"group-0\.exr is damaged"):
        check("oracle", toy_protocol(size="damaged"))


def test_a_declared_failure_is_an_answer(fakes, toy_protocol, monkeypatch):
    real = fakes.ToyAvatar.draw

    def draw(avatar, viewpoint, light):
        if viewpoint.camera.name == "side":
            raise NonFinite("the texture overflowed")
        return real(avatar, viewpoint, light)

    monkeypatch.setattr(fakes.ToyAvatar, "draw", draw)
    found = verdicts("toy-directional", toy_protocol())
    assert [law for law, verdict in found.items() if verdict.holds is False] == []
    assert found["finite"].detail == "4 of 10 queries drawn, 2 unsupported, 4 declared non-finite"
