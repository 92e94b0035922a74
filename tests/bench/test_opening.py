"""Methods can train on the people of one capture and be scored on those of another, and nobody is in both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import handbench.data
from handbench.bench import given
from handbench.bench.opening import open_data, select
from handbench.bench.plan import make_plan
from handbench.bench.progress import steps
from handbench.bench.run import run
from handbench.data.together import Together
from handbench.errors import InputError
from handbench.method import MethodInfo
from handbench.registry import Entry

TRAIN = {"segments": ["train"], "lightings": ["olat-0[0-2]", "group-*"], "capture": "toy-other", "size": "tiny"}


@pytest.fixture
def other(fakes, monkeypatch: pytest.MonkeyPatch):
    """A capture of people t01 and t02 beside the toy one, brighter, with depth."""

    class Other(fakes.ToyCapture):
        def __init__(self, digest: str = "other-digest") -> None:
            super().__init__(digest)
            self._frames = tuple(replace(frame, subject=frame.subject.replace("s", "t")) for frame in self._frames)

        @property
        def offers(self):
            return super().offers | {"depth"}

        def observe(self, frame):
            assert frame.subject.startswith("t")
            found = super().observe(frame)
            return replace(found, image=2.0 * found.image)

    monkeypatch.setattr(fakes, "open_other", lambda size, folder=None, progress=None: Other(), raising=False)
    entry = Entry("toy-other", "benchfakes:open_other", "for tests")
    monkeypatch.setattr(handbench.data, "ENTRIES", (*handbench.data.ENTRIES, entry))
    return Other


@pytest.fixture
def protocol(toy_protocol, toy_table):
    columns = [{**column, "subjects": "unseen"} for column in toy_table()["column"]]
    people = {"trained": ["t01", "t02"], "unseen": ["s01", "s02"]}
    return lambda **changes: toy_protocol(**{"train": TRAIN, "subjects": people, "column": columns, **changes})


def test_training_shows_the_one_and_scores_are_of_the_other(fakes, other, protocol, tmp_path):
    with steps() as told:
        capture = open_data(protocol(), tmp_path, told)
    selected = select(protocol(), capture)
    assert {frame.subject for frame in selected.train} == {"t01", "t02"}
    assert {f.subject for fs in (*selected.scored.values(), selected.enrol) for f in fs} == {"s01", "s02"}
    first, enrolled = selected.train[0], selected.enrol[0]
    assert np.array_equal(capture.observe(first).image, other().observe(first).image)
    assert np.array_equal(capture.observe(enrolled).image, fakes.ToyCapture().observe(enrolled).image)
    assert capture.truth(first) is first


def test_what_training_needs_is_looked_for_where_it_trains(other, protocol, tmp_path):
    with steps() as told:
        selected = select(protocol(), open_data(protocol(), tmp_path, told))
    learns = MethodInfo("m", "Mine", "for tests", universal=True, trains_on=frozenset({"depth"}))
    needs = replace(learns, trains_on=frozenset(), needs=frozenset({"depth"}))
    assert given.refusal(selected, learns, "s01") is None
    assert given.refusal(selected, needs, "s01") == "Mine needs depth maps, which the capture does not offer"


def test_somebody_who_is_in_both_is_refused(fakes, other):
    with pytest.raises(InputError, match="toy-8 and toy-8 both have a subject 's01'"):
        Together(fakes.ToyCapture(), fakes.ToyCapture())


def test_keys_cover_both_captures(fakes, other, toy_protocol, protocol):
    digests = {Together(fakes.ToyCapture(a), other(b)).digest for a in ("a", "b") for b in ("a", "b")}
    assert len(digests) == 4
    assert protocol().digest != protocol(train={**TRAIN, "size": "large"}).digest
    assert protocol().digest != protocol(capture="toy-other").digest, "what is scored counts, too"
    assert protocol().training_digest == protocol(capture="toy-other").training_digest
    plain = {**TRAIN}
    del plain["capture"], plain["size"]
    assert toy_protocol(train=plain).digest == toy_protocol().digest
    keys = {make_plan(protocol(), digest, ("toy",)).cells[0].key for digest in digests}
    assert len(keys) == 4


def test_a_run_trains_on_the_other_capture(other, protocol, tmp_path):
    done = run(protocol(), ["oracle", "toy"], out=tmp_path / "run", data=tmp_path)
    assert done.computed == 4 and not done.crashed and not done.refused


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"train": {"segments": ["train"], "capture": "toy-other"}}, "'size' is missing"),
        ({"train": {**TRAIN, "capture": ""}}, "capture is empty"),
        ({"column": "trained"}, "scores trained subjects, who are in the capture of"),
        ({"column": ["t01"]}, "scores trained subjects, who are in the capture of"),
    ],
)
def test_what_makes_no_sense_is_refused(toy_table, other, protocol, changes, reason):
    if "column" in changes:
        changes = {"column": [{**toy_table()["column"][0], "subjects": changes["column"]}]}
    with pytest.raises(InputError, match=reason):
        protocol(**changes)
