"""What a method sees: frames chosen and stripped by the protocol, in one place."""

from __future__ import annotations

import json

import pytest

from handbench.bench import given
from handbench.bench.check import check_method
from handbench.bench.drawing import timed_kind
from handbench.bench.resolving import resolve
from handbench.bench.run import run
from handbench.bench.store import Store
from handbench.errors import InputError
from handbench.method import MethodInfo
from handbench.scene import Unknown
from handbench.studies.audit import pixels
from handbench.studies.audit.evidence import Evidence
from handbench.studies.speed import methods


@pytest.fixture
def refusal(fakes, toy_protocol):
    """A function that gives why a method with some needs is refused on s02, under an [enrol] with some words more."""

    def refusal(needs=(), trains_on=(), universal: bool = True, subject: str = "s02", **enrol: object) -> str | None:
        capture = fakes.ToyCapture()
        protocol = toy_protocol(enrol={"segments": ["train"], "kinds": ["full"], **enrol})
        words = {"needs": frozenset(needs), "trains_on": frozenset(trains_on)}
        info = MethodInfo("m", "Mine", "for tests", universal=universal, **words)
        return given.refusal(resolve(protocol, capture.frames(), capture.offers), info, subject)

    return refusal


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


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ({"needs": ["depth"]}, "Mine needs depth maps, which the capture does not offer"),
        ({"needs": ["mesh", "uv"], "gives": ["image", "pose"]}, "Mine needs tracked meshes and UVs, which [enrol] of"),
        ({"needs": ["light"], "gives": ["image"]}, "Mine needs known light, which [enrol] of toy@1 does not give"),
        ({"needs": ["olat"]}, "Mine needs single-light frames of s02, and enrolment in toy@1 has none"),
        ({"trains_on": ["full"]}, "Mine trains on fully lit frames, and [train] of toy@1 selects none"),
        ({"trains_on": ["normal"]}, "Mine trains on normal maps, which the capture does not offer"),
    ],
)
def test_a_method_is_refused_with_what_is_missing(refusal, words, told):
    assert (refusal(**words) or "").startswith(told)


def test_a_method_that_is_given_what_it_needs_is_not_refused(refusal):
    assert refusal() is None
    assert refusal(["image", "mesh", "uv", "light", "full"], ["olat or group", "olat", "light"]) is None
    assert refusal(["olat"], universal=False, subject="s01") is None  # sees the training frames of s01
    assert refusal(["olat"], universal=False, subject="s01", per_identity="enrol")


def test_needs_are_of_a_closed_set():
    with pytest.raises(InputError, match="did you mean 'mesh'"):
        MethodInfo("m", "M", "for tests", needs=frozenset({"mseh"}))


def test_a_refused_cell_trains_nothing_and_says_why(fakes, toy_protocol, tmp_path):
    outcome = run(toy_protocol(), methods=["toy-needy"], out=tmp_path)
    assert not fakes.CALLS["toy-needy train"] and not outcome.crashed
    why = "Toy-Needy needs depth maps, which the capture does not offer"
    assert outcome.refused == (f"toy-needy s01 seed 0: {why}", f"toy-needy s02 seed 0: {why}")
    assert all(f"unsupported: {why}" in path.read_text() for path in tmp_path.glob("cells/*.json"))
    assert run(toy_protocol(), methods=["toy-needy"], out=tmp_path).computed == 0


def test_check_tells_what_is_missing(fakes, toy_protocol):
    (verdict,) = check_method(fakes.Toy("toy-needy", {}), toy_protocol(), fakes.ToyCapture())
    assert (verdict.law, verdict.holds) == ("needs", False) and "depth maps" in verdict.detail


def _as_enrolled(toy_protocol, **changes):
    column = {"name": "own", "title": "Own light", "subjects": "trained", "segments": ["held-out"], "kinds": ["full"]}
    columns = [{**column, "shares": ["subject", "light"], "light": "as enrolled", **changes}]
    return toy_protocol(column=columns, subjects={"trained": ["s01"], "unseen": ["s02"]})


def test_a_column_asks_for_the_light_as_enrolled(fakes, toy_protocol):
    selected = resolve(_as_enrolled(toy_protocol), fakes.ToyCapture().frames())
    frame = selected.scored["own"][0]
    query = given.asked(selected, MethodInfo("m", "M", "for tests"), frame)
    assert isinstance(query.light, Unknown) and query.lighting == given.AS_ENROLLED
    assert frame.kind != "unknown" == timed_kind(frame, query), "its time is not one under the light that it was lit by"
    assert query.viewpoint.key == frame.viewpoint.key
    elsewhere = given.asked(selected, MethodInfo("m", "M", "for tests", timed=False), frame)
    assert elsewhere.key == query.key and isinstance(elsewhere.light, Unknown)
    truth = given.asked(selected, MethodInfo("m", "M", "for tests", role="calibration", truth=True), frame)
    assert truth.key == frame.key


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"kinds": ["group"]}, "selects group-0, but enrolment shows s01 under full"),
        ({"light": "as enroled"}, "did you mean 'as enrolled'"),
        ({"shares": ["subject"]}, "scores a light that training saw"),
    ],
)
def test_a_light_that_was_not_enrolled_cannot_be_asked_for_as_enrolled(fakes, toy_protocol, changes, told):
    with pytest.raises(InputError, match=told):
        resolve(_as_enrolled(toy_protocol, **changes), fakes.ToyCapture().frames())


def test_the_light_as_enrolled_is_drawn_by_methods_with_an_estimate_of_their_own(fakes, toy_protocol, tmp_path):
    """`toy-estimates` fits its light when it enrols; `toy` has no estimate and says so."""
    run(_as_enrolled(toy_protocol), methods=["toy", "toy-estimates"], out=tmp_path)
    told = {}
    for path in tmp_path.glob("cells/*.json"):
        cell = json.loads(path.read_text())
        told[cell["method"]["name"]] = cell["scores"][0]
    assert "Toy cannot draw unknown lights" in json.dumps(told["toy"])
    assert "unsupported" not in json.dumps(told["toy-estimates"])


def test_an_audit_asks_for_the_light_as_enrolled_too(fakes, toy_protocol, tmp_path):
    protocol, capture = _as_enrolled(toy_protocol), fakes.ToyCapture()
    run(protocol, methods=["toy-estimates"], out=tmp_path)
    store = Store(tmp_path)
    plan = store.read_run()
    cells = tuple(store.read_cell(path.stem) for path in tmp_path.glob("cells/*.json"))
    holds, told = pixels.redrawn(Evidence(store, plan, cells, protocol, capture, lambda folder: None))
    assert holds, told


def test_the_speed_study_asks_what_the_protocol_tells(fakes, toy_protocol, monkeypatch):
    enrol = {"segments": ["train"], "kinds": ["full"], "gives": ["image", "alpha", "pose", "camera", "light"]}
    monkeypatch.setattr(methods, "protocol", lambda: toy_protocol(enrol=enrol))
    assert methods.study("toy", quick=True).reason == "unsupported: the mesh is not given"


def test_a_query_has_the_mesh_only_if_meshes_are_given(fakes, toy_protocol):
    for gives, there in ((["image", "alpha"], False), (["image", "mesh", "uv"], True)):
        protocol = toy_protocol(enrol={"segments": ["train"], "kinds": ["full"], "gives": gives})
        selected = resolve(protocol, fakes.ToyCapture().frames())
        frame = next(frame for frames in selected.scored.values() for frame in frames)
        query = given.asked(selected, MethodInfo("m", "M", "for tests"), frame)
        assert (query.mesh is not None) == there and query.key == frame.key and query.light is frame.light


def test_the_speed_study_lends_copies(fakes, toy_protocol, monkeypatch):
    """`toy-mutates` writes into what it is given: its row says so, and the capture stays as it is."""
    monkeypatch.setattr(methods, "protocol", toy_protocol)
    told = methods.study("toy-mutates", quick=True)
    assert not told.curves and "changed" in told.reason
