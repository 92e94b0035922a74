"""Protocols on captures that others publish fit look-alikes of them, and hide the light that nobody tells."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import phonelookalike
from lookalikes import write_goliath, write_harp, write_palm

from handbench.bench import given
from handbench.bench.opening import select
from handbench.bench.plan import make_method
from handbench.data.capture import Capture
from handbench.data.openstage import open_capture
from handbench.data.readers.goliath import GoliathCapture
from handbench.data.readers.harp import HarpCapture
from handbench.data.readers.interhand import InterHandCapture
from handbench.data.readers.uhm import UhmCapture
from handbench.data.together import Together
from handbench.protocols import parse
from handbench.registry import METHODS
from handbench.scene import Unknown

FOLDER = Path(__file__).parents[2] / "protocols"
STAGE = open_capture("mini")


def selected(name: str, capture: Capture, **changes: Any) -> Any:
    table: dict[str, Any] = tomllib.loads((FOLDER / f"{name}.toml").read_text())
    if "capture" in table["train"]:
        table["train"] |= {"size": "mini", "lightings": ["group-*", "full"]}
        table["subjects"] |= {"trained": ["s01", "s02"]}
        if name == "uhm-phone":  # one of the four is in the look-alike
            table["subjects"]["unseen"] = ["AXE977"]
        capture = Together(capture, STAGE)
    return select(parse({**table, **changes}, name), capture)


def test_palms_twelve_sequences(mano: Any, tmp_path: Path) -> None:
    write_palm(tmp_path, STAGE, mano)
    capture = InterHandCapture(tmp_path, "palm")
    assert len(capture.frames()) == 12 * 4 and {f.moment for f in capture.frames()} == {0, 1, 2, 3}
    found = selected("interhand-palm", capture)
    assert len(found.protocol.subjects) == 12 and len(found.enrol) == 12
    assert all(frame.moment == 0 and frame.segment == "fit" for frame in found.enrol)
    assert len(found.scored["later"]) == 36 and len(found.scored["as-published"]) == 48
    for name in found.protocol.methods:
        info = make_method(METHODS.entry(name), "quick").info
        assert given.refusal(found, info, "c1-ROM05-400469") is None, name
        if not info.truth:
            assert isinstance(given.asked(found, info, found.scored["later"][0]).light, Unknown)


def test_harps_split(mano: Any, tmp_path: Path) -> None:
    write_harp(tmp_path, STAGE, mano)
    found = selected("harp-sequences", HarpCapture(tmp_path))
    assert {f.pose_name[0] for f in found.enrol} == {"1"} and {f.pose_name[0] for f in found.scored["test"]} == {"6"}


def test_uhms_phone_scans(mano: Any, tmp_path: Path) -> None:
    phonelookalike.write_goliath(tmp_path, STAGE, mano)
    found = selected("uhm-phone", UhmCapture(tmp_path))
    assert [f.pose_name for f in found.enrol] == ["Right-000040", "Right-000041"]
    assert [f.pose_name for f in found.scored["test"]] == ["Right-000042"]
    for name in found.protocol.methods:
        info = make_method(METHODS.entry(name), "quick").info
        assert given.refusal(found, info, "AXE977") is None, name


def test_goliaths_hands(tmp_path: Path) -> None:
    write_goliath(tmp_path, STAGE)
    table = tomllib.loads((FOLDER / "goliath-urhand.toml").read_text())
    column = {
        **table["column"][1],
        "segments": ["train"],
        "shares": ["subject", "pose", "light"],
        "subjects": "trained",
    }
    found = selected(
        "goliath-urhand", GoliathCapture(tmp_path), subjects={"trained": ["6641280-right"]}, column=[column]
    )
    assert {f.kind for f in found.train} == {"full", "group"} and {f.kind for f in found.enrol} == {"full"}
    for name in found.protocol.methods:
        info = make_method(METHODS.entry(name), "standard").info
        assert given.refusal(found, info, "6641280-right") is None, name
