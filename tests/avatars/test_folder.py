"""Avatars on disk: what is read is what was written, and nothing else is read."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handbench.avatars.folder import _POSE, FILE, read_avatar, read_record, write_avatar
from handbench.avatars.portrait import Portrait
from handbench.data.lights import NamedLight
from handbench.errors import Damaged, InputError, StorageError, Unsupported
from handbench.method import Avatar


@pytest.fixture
def kept(whole_portrait: Portrait, tmp_path: Path) -> Path:
    return write_avatar(whole_portrait, tmp_path / "me.avatar")


def test_what_is_read_draws_what_was_written(whole_portrait: Portrait, kept: Path) -> None:
    found = read_avatar(kept)
    light = NamedLight("hall").read()
    for posture, view in (("rest", "front"), ("turned", "wide")):
        one, other = (
            p.avatar.pose(p.repertoire.viewpoint(p.repertoire.posture(posture), p.repertoire.camera(view))).relight(
                light
            )
            for p in (whole_portrait, found)
        )
        assert np.array_equal(one.image, other.image) and one.image.max() > 0.01
    assert found.name == "me" and found.repertoire.views == whole_portrait.repertoire.views
    assert found.repertoire.body is not None and found.repertoire.body.hand == "openhand"
    record = read_record(kept)
    assert (record.method, record.licence, record.subject) == ("physical", "none", "me")
    assert not [path for path in kept.rglob("*") if path.suffix in (".pkl", ".pt", ".pickle")]


def test_an_avatar_replaces_an_avatar_and_nothing_else(whole_portrait: Portrait, kept: Path, tmp_path: Path) -> None:
    write_avatar(replace(whole_portrait, licence="mine"), kept)
    assert read_record(kept).licence == "mine"
    (tmp_path / "papers").mkdir()
    (tmp_path / "papers" / "thesis.tex").write_text("years")
    with pytest.raises(StorageError, match="is no avatar"):
        write_avatar(whole_portrait, tmp_path / "papers")
    assert (tmp_path / "papers" / "thesis.tex").read_text() == "years"
    assert not [path for path in tmp_path.iterdir() if path.name.endswith(".part")]


def test_a_method_that_keeps_no_avatars_says_so_and_leaves_nothing(whole_portrait: Portrait, tmp_path: Path) -> None:
    class Fleeting(Avatar):
        def pose(self, viewpoint):  # type: ignore[no-untyped-def]
            raise AssertionError

    with pytest.raises(Unsupported, match="Fleeting cannot be kept"):
        write_avatar(replace(whole_portrait, avatar=Fleeting()), tmp_path / "x.avatar")
    assert not list(tmp_path.iterdir())


def edited(kept: Path, **changes: object) -> None:
    told = json.loads((kept / FILE).read_text())
    (kept / FILE).write_text(json.dumps({**told, **changes}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "something"}, "format is"),
        ({"schema": 99}, "schema is 99"),
        ({"method": "physicl"}, "did you mean 'physical'"),
        ({"config": {"texture": 12}}, "other settings"),
        ({"config": [["texture", 12]]}, "other settings"),
        ({"config": 10**9}, "other settings"),
        ({"files": {"../../etc/passwd": "0"}}, "inside of the folder"),
        ({"views": [["rest", "nowhere"]]}, r"views\[0\]"),
        ({"cameras": [{"name": "front", "width": 10**9, "height": 3}]}, "width"),
        ({"postures": 3}, "postures"),
        ({"licence": "\u001b[2J"}, "licence"),
    ],
)
def test_an_edited_record_is_named(kept: Path, changes: dict[str, object], message: str) -> None:
    edited(kept, **changes)
    with pytest.raises(InputError, match=message):
        read_avatar(kept)


def test_changed_missing_and_strange_files_are_named(kept: Path) -> None:
    weights = kept / "avatar" / "weights.safetensors"
    content = weights.read_bytes()
    weights.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with pytest.raises(InputError, match=r"weights\.safetensors is not what was written"):
        read_avatar(kept)
    weights.write_bytes(content)
    (kept / "extra.bin").write_bytes(b"x")
    with pytest.raises(InputError, match=r"extra.bin is no file of it"):
        read_avatar(kept)
    (kept / "extra.bin").unlink()
    weights.unlink()
    with pytest.raises(InputError, match=r"weights.safetensors is not there"):
        read_avatar(kept)
    weights.symlink_to("/etc/passwd")
    with pytest.raises(InputError, match="is a link"):
        read_avatar(kept)


@pytest.mark.parametrize("name", ["joints", "vertices"])
def test_fewer_arrays_than_poses_are_damage(kept: Path, name: str) -> None:
    path = kept / "repertoire.npz"
    with np.load(path) as stored:
        arrays = dict(stored)
    arrays |= {each: arrays[each][:1] for each in ({name} if name == "vertices" else {*_POSE})}
    np.savez_compressed(path, **arrays)
    edited(kept, files={**read_record(kept).files, path.name: hashlib.sha256(path.read_bytes()).hexdigest()})
    with pytest.raises(Damaged, match=r"repertoire\.npz is damaged"):
        read_avatar(kept)


def test_a_folder_that_is_no_avatar_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="personalise"):
        read_avatar(tmp_path)
