"""A sample of the generator in benchmarks/bad_inputs: no traceback, no hang, no silent wrong value."""

from __future__ import annotations

import itertools
import random

import pytest

from benchmarks.bad_inputs import clock
from benchmarks.bad_inputs.bases import Bases, make_bases
from benchmarks.bad_inputs.case import BAD, BadInput, CommandResult, verdict
from benchmarks.bad_inputs.families import FAMILIES, generate
from benchmarks.bad_inputs.mutate import spoiled_bytes, spoiled_json, spoiled_toml
from benchmarks.bad_inputs.runner import answers

COUNT, SEED = 60, 7


@pytest.fixture(scope="module")
def bases(tmp_path_factory: pytest.TempPathFactory) -> Bases:
    return make_bases(tmp_path_factory.mktemp("bases"))


def test_a_sample_of_bad_inputs_is_answered_rightly_or_refused_in_a_sentence(bases):
    cases = generate(COUNT, SEED, bases)
    assert len({case.family for case in cases}) >= len(FAMILIES) - 1
    found = [
        (verdict(case, answer), case.family, case.words or case.process, answer)
        for case, answer in answers(cases, jobs=1)
    ]
    assert len(found) == len(cases)
    assert not [each for each in found if each[0] in BAD]
    assert any(each[0] == "answered" for each in found) and any(each[0] == "refused" for each in found)


def test_the_same_seed_makes_the_same_inputs(bases):
    one, other = (
        [(case.family, case.words, case.files, case.special, case.process) for case in generate(40, 3, bases)]
        for _ in range(2)
    )
    assert one == other != [(c.family, c.words, c.files, c.special, c.process) for c in generate(40, 4, bases)]


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (CommandResult(0, "right"), "answered"),
        (CommandResult(0, "left"), "wrong"),
        (CommandResult(2, "", "handbench: no such thing\n"), "refused"),
        (CommandResult(2, "", ""), "mute"),
        (CommandResult(70, "", "handbench: a fault of handbench itself"), "traceback"),
        (CommandResult(1, "", "Traceback (most recent call last):\n  …"), "traceback"),
        (CommandResult(-11), "died"),
        (CommandResult(None, lost="hang"), "hang"),
    ],
)
def test_a_verdict_knows_every_way_to_fail(answer, expected):
    assert verdict(BadInput("runs", "x", ("list",), lambda out: out == "right"), answer) == expected


def test_spoiling_changes_something():
    rng = random.Random(0)
    json_text, toml_text = '{"a": [1, {"b": "c"}], "d": null}', "name = 'x'\nversion = 1\n[train]\nseeds = [0]\n"
    for spoil, sound in ((spoiled_json, json_text), (spoiled_toml, toml_text), (spoiled_bytes, b"x" * 100)):
        changed = sum(spoil(rng, sound) != sound for _ in range(100))
        assert changed > 80, spoil.__name__


def test_a_hang_is_told_by_time_that_the_process_had(tmp_path, monkeypatch):
    blocked = BadInput("commands", "blocked", (), process=("mkfifo never; read line < never",))
    assert next(answers([blocked], jobs=1, limit=0.2))[1].lost == "hang"
    assert next(answers([BadInput("commands", "brief", (), process=("exit 3",))], jobs=1, limit=5.0))[1].code == 3
    starving = itertools.count(0.0, 1e6)  # seconds for which its thread waited for a processor
    monkeypatch.setattr(clock, "_waits", lambda group: iter([("1", next(starving))]))
    late = BadInput("commands", "late", (), process=("sleep 0.3; exit 4",))
    assert next(answers([late], jobs=1, limit=0.1))[1].code == 4
