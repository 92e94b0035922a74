"""Choosing frames: nothing empty, nothing shared by accident, and a fair sample."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest

from handbench.bench.resolving import resolve
from handbench.bench.sampling import sample
from handbench.errors import InputError
from handbench.scene import Group


def test_a_column_that_shares_with_training_must_say_so(fakes, toy_table, toy_protocol):
    for column, axis, example in ((0, "light", "group-0"), (1, "light", "group-0"), (2, "pose", "s01/pose-0")):
        columns = toy_table()["column"]
        columns[column]["shares"] = [a for a in columns[column]["shares"] if a != axis] or ["subject"]
        with pytest.raises(InputError, match=f"scores a {axis} that training saw .*{example}.*add '{axis}'"):
            resolve(toy_protocol(column=columns), fakes.ToyCapture().frames())


def test_a_scored_frame_may_not_be_an_enrolment_frame(fakes, toy_table, toy_protocol):
    columns = toy_table()["column"]
    columns[1] |= {"segments": ["train"], "kinds": ["full"]}
    with pytest.raises(InputError, match="s02/pose-0 under full, which enrolment shows"):
        resolve(toy_protocol(column=columns), fakes.ToyCapture().frames())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"subjects": {"trained": ["s09"], "unseen": ["s02"]}}, "the capture has no subject 's09'; it has s01, s02"),
        ({"train": {"segments": ["trian"]}}, r"\[train\] selects no frame"),
        ({"enrol": {"lightings": ["fulll"]}}, r"\[enrol\] selects no frame of subject 's01'"),
    ],
)
def test_empty_selections(fakes, toy_protocol, changes, message):
    with pytest.raises(InputError, match=message):
        resolve(toy_protocol(**changes), fakes.ToyCapture().frames())


def test_a_column_without_frames(fakes, toy_table, toy_protocol):
    columns = toy_table()["column"]
    columns[3]["lightings"] = ["env-moon"]
    with pytest.raises(InputError, match="column 'env' selects no frame"):
        resolve(toy_protocol(column=columns), fakes.ToyCapture().frames())


def test_a_sample_is_even_over_every_axis(fakes):
    frames = [f for f in fakes.ToyCapture().frames() if f.kind == "olat"]  # 2 subjects, 3 poses, 2 cameras, 4 lights
    chosen = sample(frames, 24, seed=0)
    assert len({frame.key for frame in chosen}) == 24
    for axis in ("subject", "pose_name", "lighting"):
        counts = Counter(getattr(frame, axis) for frame in chosen)
        assert max(counts.values()) == min(counts.values()), (axis, counts)
    counts = Counter((frame.subject, frame.camera.name) for frame in chosen)
    assert max(counts.values()) - min(counts.values()) <= 1, "pairs of axes are even too"


def test_a_sample_is_seeded_and_blind_to_the_order_of_frames(fakes):
    frames = fakes.ToyCapture().frames()
    keys = [frame.key for frame in sample(frames, 10, seed=3)]
    assert keys == [frame.key for frame in sample(frames[::-1], 10, seed=3)]
    assert keys != [frame.key for frame in sample(frames, 10, seed=4)]
    assert keys == sorted(keys)
    assert len(sample(frames, None, seed=0)) == len(frames)


def test_the_digest_covers_what_decides_a_score_and_nothing_else(toy_table, toy_protocol):
    digest = toy_protocol().digest
    columns = toy_table()["column"]
    columns[0]["title"] = "Other"
    same = {"title": "Other", "summary": "Other", "methods": ["mean"], "seeds": [7], "preset": "x", "column": columns}
    assert toy_protocol(**same).digest == digest
    columns = toy_table()["column"]
    columns[0]["limit"] = 1
    for change in (
        {"version": 2},
        {"size": "other"},
        {"column": columns},
        {"metrics": ["ssim"]},
        {"sample_seed": 1},
        {"train": {"segments": ["train"]}},
        {"enrol": {"segments": ["train"]}},
        {"subjects": {"trained": ["s02"], "unseen": ["s01"]}},
    ):
        assert toy_protocol(**change).digest != digest, change


@pytest.mark.parametrize(("part", "lighting"), [("train", "group-0"), ("enrol", "full")])
def test_a_held_out_light_inside_a_group_is_found(fakes, toy_protocol, part, lighting):
    frames = fakes.ToyCapture().frames()
    held_out = next(f.light for f in frames if f.lighting == "olat-03")
    other = next(f.light for f in frames if f.lighting == lighting)
    hidden = Group((other, Group((held_out.scaled(0.25),))))
    mixed = [replace(f, light=hidden) if f.lighting == lighting else f for f in frames]
    resolve(toy_protocol(), frames)
    with pytest.raises(InputError, match=f"scores a light that training saw .olat-03 has a light of {lighting}"):
        resolve(toy_protocol(), mixed)
