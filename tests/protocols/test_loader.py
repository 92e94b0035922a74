"""A protocol file is read whole or refused with what is wrong in it."""

from __future__ import annotations

import os
import re
import time
import tomllib
from dataclasses import replace
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


def test_there_may_be_no_unseen_subject():
    told = table()
    told["subjects"] = {"trained": ["s01"], "unseen": []}
    told["column"] = [column for column in told["column"] if column["subjects"] == "trained"]
    assert parse(told, "x").unseen == () and parse(told, "x").subjects == ("s01",)


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("sedes",), [0], "unknown key in protocol x: 'sedes'; did you mean 'seeds'"),
        (("train", "segment"), ["train"], "'segment'; did you mean 'segments'?"),
        (("column", 0, "limits"), 3, "'limits'; did you mean 'limit'"),
        (("subjects", "seen"), ["s01"], r"\[subjects\]: 'seen'; did you mean 'unseen'"),
        (("version",), 0, "version is 0; give a whole number, at least 1"),
        (("name",), "../up", r"name is '\.\./up'; use up to 64 letters"),
        (("name",), "a/b", "use up to 64 letters"),
        (("name",), "x" * 65, "use up to 64 letters"),
        (("name",), ".", "use up to 64 letters"),
        (("title",), "a\x1b[31m", "title is 'a.x1b.31m'; give one line without control characters"),
        (("column", 0, "title"), "two\nlines", "give one line"),
        (("column", 0, "title"), "turned \u202e round", "give one line"),
        (("published_note",), "a\n\nb", "published_note is .* give one line"),
        (("metrics",), ["psnr\x07"], "give a list of texts"),
        (("presets",), {"ur\nhand": "quick"}, "key 'ur.nhand' is no line"),
        (("title",), "\ud800", "half a character"),
        (("version",), 2**63, "does not fit into 64 bits"),
        (("sample_seed",), 10**1000, "a whole number of 3322 bits does not fit"),
        (("version",), True, "version is True; give a whole number"),
        (("version",), "1", "version is '1'; give a whole number"),
        (("title",), " ", "title is empty"),
        (("metrics",), [], r"metrics is \[\]; give a list of texts, not empty"),
        (("metrics",), ["psnr", "psnr"], "'psnr' is given twice"),
        (("seeds",), [0, -1], r"seeds is \[0, -1\]"),
        (("train",), ["train"], r"give a \[train\] table"),
        (("enrol", "kinds"), ["ful"], "kind of frame is 'ful'; use one of olat, group, full, environment"),
        (("column",), [], r"no \[\[column\]\]"),
        (("column", 0), 3, "column 1: expected a table, got 3"),
        (("column", 0, "subjects"), "all", '(unseen-segment): subjects is \'all\'; write "trained", "unseen" or a'),
        (("column", 0, "subjects"), ["s03"], "unknown subject in .*: 's03'; did you mean 's02' or 's01'"),
        (("column", 0, "subjects"), ["s01", "s02"], "are of both groups; name trained or unseen ones"),
        (("column", 0, "subjects"), [], r"subjects is \[\]; give a list of texts, not empty"),
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
    with pytest.raises(InputError, match=r"absent\.toml does not exist"):
        load(tmp_path / "absent.toml")
    (tmp_path / "broken.toml").write_text("name = \n")
    with pytest.raises(InputError, match=r"broken\.toml is not valid TOML: .*line 1"):
        load(tmp_path / "broken.toml")
    (tmp_path / "latin.toml").write_bytes(b'name = "\xe9"')
    with pytest.raises(InputError, match="no UTF-8"):
        load(tmp_path / "latin.toml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = " + "[" * 900 + "]" * 900, "nested deeper"),
        ("x = " + "{a=" * 900 + "1" + "}" * 900, "nested deeper"),
        (".".join("a" * 100_000) + " = 1", "nested deeper"),
        ("[" + ". ".join(["a"] * 50_000) + "]", "nested deeper"),
        ('"a".' * 50_000 + "b = 1", "nested deeper"),
        ("[[" + ".".join("a" * 50_000) + "]]", "nested deeper"),
        ("version = " + "9" * 5000, "a number has thousands of digits"),
        ("version = 0x" + "f" * 5000, "a whole number of 20000 bits does not fit into 64 bits"),
        ("version = 9223372036854775808", "9223372036854775808 does not fit into 64 bits"),
        ("seeds = [1, 18446744073709551616]", "18446744073709551616 does not fit"),
        ('title = "\\uD800"', "not valid TOML"),
        ("a" * 100_000 + " = 1", r"unknown key in protocol .*'aaa.* \(100002 characters\); known: "),
        ("x = 1\n" * 50_000, "more than the 262,144"),
        ('"""' + "x\\" * 100_000, "not valid TOML"),
    ],
)
def test_files_that_are_traps_are_one_short_sentence_at_once(tmp_path, text, message):
    path = tmp_path / "a.toml"
    path.write_text(text)
    start = time.perf_counter()
    with pytest.raises(InputError, match=message) as caught:
        load(path)
    assert time.perf_counter() - start < 2
    assert len(str(caught.value)) < 600 + len(str(path))


def test_what_is_no_file_is_no_protocol(tmp_path):
    os.mkfifo(tmp_path / "fifo.toml")
    (tmp_path / "endless.toml").symlink_to("/dev/zero")
    (tmp_path / "folder.toml").mkdir()
    for name in ("fifo", "endless", "folder"):
        with pytest.raises(InputError, match="give a regular file"):
            load(tmp_path / f"{name}.toml")


def test_structure_in_texts_and_comments_is_none(tmp_path):
    dots = ". . a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q.r.s [[[[[[[[[[[[[[[[[[[[[[ {{{{ "
    text = (FOLDER / "smoke.toml").read_text() + f"\n# {dots}\n"
    for quote in ('"', "'", '"""', "'''"):
        path = tmp_path / "a.toml"
        path.write_text(re.sub("^summary = .*$", f"summary = {quote}{dots}{quote}", text, count=1, flags=re.MULTILINE))
        assert load(path).summary == dots


def test_quick_and_smoke_keep_their_digests():
    """A change of these throws away every kept cell and training: it must be meant."""
    found = {name: (PROTOCOLS.load(name).digest[:12], PROTOCOLS.load(name).training_digest[:12]) for name in KEPT}
    assert found == KEPT


KEPT = {"quick": ("57621408a155", "1a094be7a68e"), "smoke": ("d94b5a64b421", "d99796e00c2d")}


def test_a_column_may_name_its_subjects():
    content = table()
    content["subjects"] = {"trained": ["s01", "s02"], "unseen": ["s03", "s04"]}
    content["column"] = [
        {**content["column"][0], "subjects": ["s02"]},
        {**content["column"][1], "subjects": ["s04", "s03"]},
    ]
    protocol = parse(content, "x")
    assert [protocol.subjects_of(column) for column in protocol.columns] == [("s02",), ("s04", "s03")]
    assert protocol.subjects == ("s02", "s03", "s04"), "a subject that no column scores is not worked on"


ROW = {"method": "absent", "title": "Absent", "marker": "†", "source": "A paper, Table 1"}


def published(**changes) -> dict:
    return {**table(), "published": [{**ROW, "values": {"environment": {"psnr": 30}}, **changes}]}


def test_published_numbers_are_read_and_change_no_digest():
    with_rows = parse({**published(), "published_note": "No window is told."}, "x")
    (row,) = with_rows.published
    assert row.values == (("environment", "psnr", 30.0),)
    assert (row.method, row.title, row.marker, row.source) == ("absent", "Absent", "†", "A paper, Table 1")
    assert with_rows.published_note == "No window is told."
    bare = parse(table(), "x")
    assert (with_rows.digest, with_rows.training_digest) == (bare.digest, bare.training_digest)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"values": {"enviroment": {"psnr": 30}}}, "unknown key in .*published 1 .absent. values:.*'environment'"),
        ({"values": {"environment": {"psrn": 30}}}, "values of environment:.*'psrn'; did you mean 'psnr'"),
        ({"values": {"environment": {"psnr": "30"}}}, "psnr is '30'; give a number"),
        ({"values": {"environment": {"psnr": float("nan")}}}, "psnr is nan; leave out what is not published"),
        ({"values": {}}, "values is empty; give a number or remove the row"),
        ({"values": {"environment": 30.0}}, "values of environment: expected a table"),
        ({"source": ""}, "source is empty"),
        ({"marker": 1}, "marker is 1; give a text"),
        ({"tilte": "x"}, "'tilte'; did you mean 'title'"),
    ],
)
def test_published_numbers_that_fit_nothing_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        parse(published(**changes), "x")


def test_a_pattern_gives_a_family_of_methods_its_preset() -> None:
    smoke = PROTOCOLS.load("smoke")
    assert smoke.preset_of("urhand") == smoke.preset_of("urhand-non-linear") == "smoke"
    assert smoke.preset_of("phong") == "quick"
    special = replace(smoke, presets=(("urhand-*", "smoke"), ("urhand-phong", "standard")))
    assert special.preset_of("urhand-phong") == "standard"  # a name is stronger than a pattern
    assert special.preset_of("urhand") == "quick"


def test_the_examples_of_the_document_are_protocols():
    text = (Path(__file__).parents[2] / "docs" / "protocols.md").read_text()
    protocol, elsewhere, published = map(tomllib.loads, re.findall(r"```toml\n(.*?)```", text, re.DOTALL))
    phone = tomllib.loads((Path(__file__).parents[2] / "protocols" / "phone.toml").read_text())
    assert parse({**phone, **elsewhere}, "docs").trains_on == ("openstage", "quick")
    parsed = parse({**protocol, **published}, "docs")
    assert parsed.preset_of("urhand-phong") == "ablation" and len(parsed.published) == 1
