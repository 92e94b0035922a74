"""A protocol file is read whole or refused with what is wrong in it."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

import handbench.protocols
from handbench.errors import InputError
from handbench.protocols import load, parse
from handbench.registry import METHODS, METRICS, PROTOCOLS

FOLDER = Path(handbench.protocols.__file__).parent


def table() -> dict:
    return tomllib.loads((FOLDER / "smoke.toml").read_text())


@pytest.mark.parametrize("name", sorted(PROTOCOLS.entries()))
def test_shipped_protocols_load_and_name_what_exists(name):
    protocol = PROTOCOLS.load(name)
    assert protocol.name == name and PROTOCOLS.entry(name).summary == protocol.summary
    assert set(protocol.methods) <= set(METHODS.entries())
    assert {metric.partition(":")[0] for metric in protocol.metrics} <= set(METRICS.entries())


def test_quick_answers_its_four_questions():
    quick = PROTOCOLS.load("quick")
    assert [column.name for column in quick.columns] == [
        "unseen-segment",
        "unseen-subject",
        "unseen-light",
        "environment",
    ]
    assert 100 <= sum(column.limit for column in quick.columns) <= 120
    assert quick.subjects == ("s01", "s02", "s03", "s04", "s05", "s06")


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("sedes",), [0], "unknown key in protocol x: 'sedes'; did you mean 'seeds'"),
        (("train", "segment"), ["train"], "'segment'; did you mean 'segments'?"),
        (("column", 0, "limits"), 3, "'limits'; did you mean 'limit'"),
        (("subjects", "seen"), ["s01"], r"\[subjects\]: 'seen'; did you mean 'unseen'"),
        (("version",), 0, "version is 0; give a whole number, at least 1"),
        (("version",), True, "version is True; give a whole number"),
        (("version",), "1", "version is '1'; give a whole number"),
        (("title",), " ", "title is empty"),
        (("metrics",), [], r"metrics is \[\]; give a list of texts, not empty"),
        (("metrics",), ["psnr", "psnr"], "'psnr' is given twice"),
        (("seeds",), [0, -1], r"seeds is \[0, -1\]"),
        (("train",), ["train"], r"give a \[train\] table"),
        (("enrol", "kinds"), ["ful"], "unknown kind of frame .* 'ful'; did you mean 'full'"),
        (("column",), [], r"no \[\[column\]\]"),
        (("column", 0), 3, "column 1: expected a table, got 3"),
        (("column", 0, "subjects"), "all", '(unseen-segment): subjects is \'all\'; write "trained" or "unseen"'),
        (("column", 0, "shares"), ["lights"], "'lights'; did you mean 'light'"),
        (("column", 1, "name"), "unseen-segment", "column name 'unseen-segment' is given twice"),
        (("subjects",), {"trained": ["s01"]}, "lists no unseen subject"),
        (("subjects", "unseen"), ["s01"], "'s01' is both trained and unseen"),
        (("aggregation",), ["query", "seed", "subject"], "reports average in the order"),
        (("presets", "urhand"), 3, r"\[presets\]: urhand is 3"),
    ],
)
def test_what_is_wrong_is_named(place, value, message):
    content = table()
    inner = content
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    with pytest.raises(InputError, match=message.replace("(", r"\(").replace(")", r"\)").replace("?", r"\?")):
        parse(content, "x")


@pytest.mark.parametrize("key", ["name", "version", "title", "capture", "size", "train", "enrol", "column", "metrics"])
def test_what_is_missing_is_named(key):
    content = table()
    del content[key]
    with pytest.raises(InputError, match=f"'{key}' is missing; give"):
        parse(content, "x")


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(InputError, match=r"absent\.toml cannot be read"):
        load(tmp_path / "absent.toml")
    (tmp_path / "broken.toml").write_text("name = \n")
    with pytest.raises(InputError, match=r"broken\.toml is not valid TOML: .*line 1"):
        load(tmp_path / "broken.toml")
    (tmp_path / "latin.toml").write_bytes(b'name = "\xe9"')
    with pytest.raises(InputError, match="not valid TOML"):
        load(tmp_path / "latin.toml")
