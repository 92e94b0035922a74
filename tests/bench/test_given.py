"""What a method sees: frames chosen and stripped by the protocol, in one place."""

from __future__ import annotations

import pytest

from handbench.bench import given
from handbench.bench.protocol import resolve
from handbench.errors import InputError
from handbench.method import MethodInfo


@pytest.fixture
def enrolled(fakes, toy_protocol):
    """A function that gives the keys that a method sees of s01 under an [enrol] with some words more."""

    def enrolled(universal: bool = True, truth: bool = False, **enrol: object) -> list[str]:
        capture = fakes.ToyCapture()
        protocol = toy_protocol(enrol={"segments": ["train"], "kinds": ["full"], **enrol})
        info = MethodInfo(
            "m", "M", "for tests", universal=universal, role="calibration" if truth else "method", truth=truth
        )
        seen = given.enrolment(resolve(protocol, capture.frames()), info, "s01", capture.observe)
        return [frame.key for frame in seen.frames]

    return enrolled


def test_a_method_without_a_universal_prior_sees_what_the_protocol_says(enrolled):
    full = enrolled()
    assert len(full) == 4 and all(key.endswith("/full") for key in full)
    more = enrolled(universal=False)
    assert more[:4] == full and len(more) == 4 + 2 * 2 * 4  # poses, cameras, olat-00 to 02 and group-0
    assert enrolled(universal=False, per_identity="enrol") == full


def test_the_truth_sees_the_scored_frames_too(enrolled):
    assert "s01/pose-2/front/group-0" in enrolled(truth=True)
    assert "s01/pose-2/front/group-0" not in enrolled(universal=False)


def test_count_takes_so_many_frames_of_each_subject(enrolled):
    one = enrolled(count=1)
    assert len(one) == 1 and enrolled(count=1) == one
    assert set(one) < set(enrolled(count=3)) or len(enrolled(count=3)) == 3
    assert enrolled(count=100) == enrolled()


def test_what_enrolment_says_changes_the_digest_and_the_usual_does_not(toy_protocol):
    usual = {"segments": ["train"], "kinds": ["full"]}
    plain = toy_protocol(enrol=usual).digest
    assert toy_protocol(enrol={**usual, "per_identity": "train"}).digest == plain
    for more in ({"count": 1}, {"gives": ["image", "alpha"]}, {"per_identity": "enrol"}):
        assert toy_protocol(enrol={**usual, **more}).digest != plain


@pytest.mark.parametrize(
    ("enrol", "told"),
    [
        ({"count": 0}, "count is 0"),
        ({"gives": ["imge"]}, "did you mean 'image'"),
        ({"gives": ["alpha", "mesh"]}, 'gives is without "image"'),
        ({"gives": []}, "not empty"),
        ({"per_identity": "all"}, "known: enrol, train"),
    ],
)
def test_nonsense_in_enrol_is_told_in_a_sentence(toy_protocol, enrol, told):
    with pytest.raises(InputError, match=told):
        toy_protocol(enrol=enrol)


def test_a_recording_reads_no_frame_but_its_own(fakes, toy_protocol):
    capture = fakes.ToyCapture()
    selected = resolve(toy_protocol(), capture.frames())
    seen = given.training(selected, capture.observe)
    held_out = next(frame for frames in selected.scored.values() for frame in frames)
    with pytest.raises(InputError, match="not one of this recording"):
        seen.observe(held_out)
    with pytest.raises(InputError, match="not one of this recording"):
        seen.of_kind("olat").observe(held_out)
