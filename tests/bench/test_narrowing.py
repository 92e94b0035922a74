"""Less of a protocol is another protocol, which trains the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from handbench.bench.naming import run_folder
from handbench.bench.narrowing import narrowed, narrowed_as
from handbench.bench.plan import make_plan
from handbench.bench.reopening import protocol_of
from handbench.bench.run import run
from handbench.errors import InputError
from handbench.reports import table
from handbench.results.reading import read_run
from handbench.settings import Setting


def test_one_subject_is_scored_and_all_are_trained_on(fakes, toy_protocol, tmp_path):
    protocol = narrowed(toy_protocol(), ("s02",))
    assert [column.name for column in protocol.columns] == ["subject"] and protocol.subjects == ("s02",)
    assert run(protocol, out=tmp_path).computed == 1
    found = table(tmp_path)
    assert found.title == "Toy: only s02 (toy@1)"
    assert all(cell.complete for row in found.rows for cell in row.cells), "what is left out is not missing"


def test_a_training_is_shared_with_the_whole_protocol_and_cells_are_not(fakes, toy_protocol):
    whole, part = (make_plan(each, "digest").cells for each in (toy_protocol(), narrowed(toy_protocol(), ("s02",))))
    assert part[0].prior == whole[1].prior and part[0].key != whole[1].key


def test_a_limit_keeps_the_lower_of_two(toy_protocol, toy_table):
    columns = toy_table()["column"]
    columns[0]["limit"] = 1
    protocol = narrowed(toy_protocol(column=columns), limit=2)
    assert [column.limit for column in protocol.columns] == [1, 2, 2, 2]
    assert protocol.title == "Toy: at most 2 frames a column"
    assert narrowed(protocol) is protocol


def test_published_values_of_columns_that_go_go_too(toy_protocol):
    published = [
        {"method": "toy", "title": "T", "source": "A", "values": {"light": {"psnr": 3}, "subject": {"psnr": 4}}}
    ]
    (row,) = narrowed(toy_protocol(published=published), ("s02",)).published
    assert row.values == (("subject", "psnr", 4.0),)


@pytest.mark.parametrize(("subjects", "limit"), [(("s02",), None), (("s01", "s02"), 1), (None, 2)])
def test_the_title_tells_how_a_protocol_was_narrowed(toy_protocol, subjects, limit):
    whole = toy_protocol()
    part = narrowed(whole, subjects, limit)
    assert narrowed_as(whole, part.title) == part != whole
    assert narrowed_as(whole, whole.title) is narrowed_as(whole, "Toy: only for you") is whole


def test_a_part_of_a_protocol_has_a_run_folder_of_its_own(toy_protocol):
    whole = toy_protocol()
    settings = (Setting.parse("steps=5"), Setting.parse("urhand*:rate=1e-3"))
    assert run_folder(whole) == Path("runs/toy")
    assert run_folder(narrowed(whole, ("s02",), 4)) == Path("runs/toy-s02-limit-4")
    assert run_folder(whole, settings) == Path("runs/toy-steps-5-urhand-rate-1e-3")


def test_a_narrowed_run_finds_its_protocol_again(fakes, toy_protocol, tmp_path, monkeypatch):
    run(narrowed(toy_protocol(), ("s02",), 1), out=tmp_path)
    monkeypatch.setattr("handbench.bench.reopening.find_protocol", lambda name: {"toy": toy_protocol()}[name])
    assert protocol_of(read_run(tmp_path), None) == narrowed(toy_protocol(), ("s02",), 1)
    monkeypatch.setattr("handbench.bench.reopening.find_protocol", lambda name: toy_protocol(metrics=["ssim"]))
    with pytest.raises(InputError, match="protocol toy@1 is not the one"):
        protocol_of(read_run(tmp_path), None)


def test_what_is_not_there_is_refused(toy_protocol):
    with pytest.raises(InputError, match="unknown subject of protocol toy@1: 's03'; did you mean"):
        narrowed(toy_protocol(), ("s03",))
    with pytest.raises(InputError, match="limit is 0; give at least 1"):
        narrowed(toy_protocol(), limit=0)
