"""Each law has a method that breaks it alone."""

from __future__ import annotations

import pytest

from handbench.bench.check import check


def verdicts(name, protocol):
    return {verdict.law: verdict for verdict in check(name, protocol)}


def test_a_lawful_method(fakes, toy_protocol):
    found = verdicts("toy", toy_protocol())
    assert [verdict.holds for verdict in found.values()] == [True] * 5
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
