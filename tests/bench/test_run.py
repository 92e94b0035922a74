"""A run computes what is missing, once, and a method's failure is a reason in its own scores."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flat import flat_cells as cells

from handbench.bench.reader import CaptureReader
from handbench.bench.run import find_protocol, run
from handbench.bench.store import Store
from handbench.data.exr import read_exr
from handbench.errors import InputError
from handbench.reports import table
from handbench.results.measured import CurvePoint
from handbench.results.record import PublishedRecord
from handbench.scene import Directional, Environment, Group, leaves
from handbench.skips import note

ROOT = Path(__file__).parent


def scores(folder: Path, method: str) -> dict[tuple[str, str], dict]:
    return {(s["column"], s["query"]): s for c in cells(folder) if c["method"]["name"] == method for s in c["scores"]}


def comparable(folder: Path) -> str:
    """Everything but times, memory and provenance."""
    left = ("times", "cost", "provenance")
    kept = [{k: v for k, v in cell.items() if k not in left} for cell in cells(folder)]
    return json.dumps(kept, sort_keys=True)


def test_a_run_scores_every_query_and_times_the_method(fakes, toy_protocol, tmp_path):
    outcome = run(toy_protocol(), out=tmp_path / "run", command=["handbench", "run", "toy"])
    assert (outcome.computed, outcome.reused, outcome.crashed) == (2, 0, ())
    told = Store(tmp_path / "run").run()
    assert told.provenance.command == "handbench run toy"
    assert told.protocol.metrics[0].signature.startswith("psnr|")
    expected = {(c.name, q) for c in told.protocol.columns for q in c.queries}
    assert len(expected) == 2 + 2 + 4 + 2
    found = scores(tmp_path / "run", "toy")
    assert set(found) == expected
    assert all(np.isfinite(score["value"]) for score in found.values())
    first = cells(tmp_path / "run")[0]
    assert first["times"]["new_pose_ms"]["group"]["n"] > 0 and first["times"]["train_s"] > 0
    assert first["same_pixels"] is True
    assert {"cpu", "cores", "memory_gb"} <= set(first["device"])
    if sys.platform == "linux":
        assert 10 < first["cost"]["peak_mb"] < 1e5 and 10 < first["cost"]["train_peak_mb"] < 1e5
    assert first["cost"]["weights_bytes"] > 0 and first["cost"]["drawn"] > 0


def test_the_oracle_is_perfect_and_its_predictions_are_kept(fakes, toy_protocol, tmp_path):
    run(toy_protocol(), methods=["oracle"], out=tmp_path)
    found = scores(tmp_path, "oracle")
    assert {score["value"] for score in found.values()} == {100.0}  # the cap of psnr
    truth = fakes.ToyCapture()
    frames = {frame.key: frame for frame in truth.frames()}
    for cell in cells(tmp_path):
        for score in cell["scores"]:
            kept = read_exr(Store(tmp_path).picture(cell["key"], score["query"]))
            np.testing.assert_allclose(kept["G"], truth.observe(frames[score["query"]]).image[..., 1], rtol=1e-3)


def test_one_training_serves_all_subjects_and_a_second_run_does_nothing(fakes, toy_protocol, tmp_path):
    protocol = toy_protocol()
    run(protocol, out=tmp_path)
    assert fakes.CALLS["toy train"] == 1 and fakes.CALLS["toy personalise"] == 2
    before = (tmp_path / "run.json").read_bytes()
    fakes.CALLS.clear()
    outcome = run(protocol, out=tmp_path)
    assert (outcome.computed, outcome.reused) == (0, 2)
    assert set(fakes.CALLS) == {"open", "toy create"}, "a cached run reads no image; a plug-in tells its configuration"
    assert (tmp_path / "run.json").read_bytes() == before


def test_the_true_mesh_is_worked_out_only_if_a_metric_asks(fakes, toy_protocol, tmp_path, monkeypatch):
    calls: list[object] = []
    real = CaptureReader.surface
    monkeypatch.setattr(CaptureReader, "surface", lambda self, frame: calls.append(frame) or real(self, frame))
    run(toy_protocol(metrics=["psnr"]), methods=["oracle"], out=tmp_path / "pictures")
    assert not calls
    run(toy_protocol(metrics=["psnr", "surface-mean"]), methods=["oracle"], out=tmp_path / "geometry")
    assert calls


def test_only_missing_cells_are_computed_and_equal_an_uninterrupted_run(fakes, toy_protocol, tmp_path):
    protocol = toy_protocol()
    run(protocol, out=tmp_path / "whole", seeds=[0, 1])
    run(protocol, out=tmp_path / "killed", seeds=[0, 1])
    lost = Store(tmp_path / "killed").run().cells[1]
    (tmp_path / "killed" / "cells" / f"{lost}.json").write_text('{"schema": 1, "key": "')  # torn by a bad disk
    fakes.CALLS.clear()
    outcome = run(protocol, out=tmp_path / "killed", seeds=[0, 1])
    assert (outcome.computed, outcome.reused) == (1, 3)
    assert fakes.CALLS["toy train"] == 0 and fakes.CALLS["toy personalise"] == 1
    assert comparable(tmp_path / "killed") == comparable(tmp_path / "whole")


def test_an_interrupted_run_keeps_finished_cells_and_resumes(fakes, toy_protocol, tmp_path):
    protocol = toy_protocol()
    # The first subject takes 28 calls: 3 warm-ups, 8 queries, 8 again, and for the laws 3 lights, 4 scaled, 2 pairs.
    fakes.STOP_AT["toy"] = 29
    with pytest.raises(KeyboardInterrupt):
        run(protocol, out=tmp_path)
    assert len(list((tmp_path / "cells").iterdir())) == 1
    assert not [path for path in tmp_path.rglob("*") if path.name.endswith((".tmp", ".part"))]
    fakes.STOP_AT.clear()
    outcome = run(protocol, out=tmp_path)
    assert (outcome.computed, outcome.reused) == (1, 1)
    assert fakes.CALLS["toy train"] == 1


def test_nan_predictions_are_visible_as_reasons(fakes, toy_protocol, tmp_path):
    run(toy_protocol(), methods=["toy-nan"], out=tmp_path)
    for (_, query), score in scores(tmp_path, "toy-nan").items():
        if "/side/" in query:
            assert score["value"] is None
            assert score["reason"] == "non-finite: 3 values of the prediction are NaN or infinite"
        else:
            assert score["value"] is not None and score["reason"] is None


def test_a_crash_is_a_reason_and_stops_no_other_cell(fakes, toy_protocol, tmp_path):
    protocol = toy_protocol(methods=["toy-crash-train", "toy-crash", "toy"])
    outcome = run(protocol, out=tmp_path)
    assert outcome.computed == 6
    assert {s["reason"] for s in scores(tmp_path, "toy-crash-train").values()} == {"crashed: ValueError: no such layer"}
    by_subject = {query[:3]: score["reason"] for (_, query), score in scores(tmp_path, "toy-crash").items()}
    assert by_subject == {"s01": None, "s02": "crashed: KeyError: 'weights'"}
    assert all(score["value"] is not None for score in scores(tmp_path, "toy").values())
    assert fakes.CALLS["toy-crash-train train"] == 1, "a failed training is not tried again for the next subject"
    assert outcome.crashed == (
        "toy-crash-train s01 seed 0: crashed: ValueError: no such layer",
        "toy-crash-train s02 seed 0: crashed: ValueError: no such layer",
        "toy-crash s02 seed 0: crashed: KeyError: 'weights'",
    )
    assert "KeyError" in next(c["error"] for c in cells(tmp_path) if c["method"]["name"] == "toy-crash" and c["error"])
    again = run(protocol, out=tmp_path)
    assert (again.computed, again.reused) == (3, 3), "crashed cells alone are tried again"


@pytest.mark.parametrize(
    ("method", "reason"),
    [
        ("toy-memory", "out of memory"),
        ("toy-diverges", "non-finite: the texture overflowed"),
        ("toy-small", "unsupported: the picture is 8x4, its camera says 8x8"),
    ],
)
def test_reasons(fakes, toy_protocol, tmp_path, method, reason):
    run(toy_protocol(), methods=[method], out=tmp_path)
    assert {score["reason"] for score in scores(tmp_path, method).values()} == {reason}


def test_what_a_method_cannot_do_is_final_and_counts_as_no_crash(fakes, toy_protocol, tmp_path):
    outcome = run(toy_protocol(), methods=["toy-no-environment"], out=tmp_path)
    assert outcome.crashed == ()
    found = scores(tmp_path, "toy-no-environment")
    assert {column for (column, _), s in found.items() if s["reason"] == "unsupported: no environment light"} == {"env"}
    assert run(toy_protocol(), methods=["toy-no-environment"], out=tmp_path).computed == 0


def test_enrolment_is_fully_lit_frames_and_own_training_frames_for_methods_of_one_identity(
    fakes, toy_protocol, tmp_path
):
    run(toy_protocol(), methods=["toy", "toy-identity"], out=tmp_path)
    assert fakes.CALLS["toy enrolled with full"] == 2
    assert fakes.CALLS["toy-identity enrolled with full+group+olat"] == 1
    assert fakes.CALLS["toy-identity enrolled with full"] == 1


@pytest.mark.parametrize("method", ["toy", "oracle"])  # the bench, or a method, is the first to read it
def test_a_damaged_frame_is_named_and_the_others_are_scored(fakes, toy_protocol, tmp_path, method):
    outcome = run(toy_protocol(size="damaged"), methods=[method], out=tmp_path)
    key = "s02/pose-2/front/group-0"
    found = {query: score for (_, query), score in scores(tmp_path, method).items()}
    assert found.pop(key)["reason"] == f"bad frame: {key}: image {key}.exr is damaged; make the capture again"
    assert all(np.isfinite(score["value"]) for score in found.values())
    assert len(outcome.crashed) == 1 and f"bad frame: {key}" in outcome.crashed[0]
    again = run(toy_protocol(size="damaged"), methods=[method], out=tmp_path)
    assert (again.computed, again.reused) == (1, 1), "what is mended is scored by the next run"


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (lambda seen: FileNotFoundError(2, "No such file or directory", "a.exr"), "FileNotFoundError: .*a.exr"),
        (lambda seen: replace(seen, image=np.full((8, 8, 3), np.nan)), "image holds 192 values that are NaN"),
        (lambda seen: replace(seen, image=np.zeros((6, 8, 3)), alpha=np.zeros((6, 8))), "8x6, its camera says 8x8"),
        (lambda seen: replace(seen, alpha=None), "no alpha"),
        (lambda seen: replace(seen, image=np.zeros((8, 8, 3), np.uint8)), r"whole numbers \(uint8\)"),
        (lambda seen: None, "gives a NoneType"),
        (lambda seen: SystemExit(3), "SystemExit: 3"),
    ],
)
def test_whatever_is_wrong_with_a_frame(fakes, toy_protocol, tmp_path, monkeypatch, wrong, told):
    honest, key = fakes.ToyCapture.observe, "s02/pose-2/front/group-0"

    def observe(self, frame):
        seen = honest(self, frame)
        found = wrong(seen) if frame.key == key else seen
        if isinstance(found, BaseException):
            raise found
        return found

    monkeypatch.setattr(fakes.ToyCapture, "observe", observe)
    run(toy_protocol(), out=tmp_path)
    found = {query: score for (_, query), score in scores(tmp_path, "toy").items()}
    assert re.match(f"bad frame: {key}: .*{told}", found.pop(key)["reason"])
    assert all(np.isfinite(score["value"]) for score in found.values())


def test_a_bad_frame_of_training_is_no_fault_of_the_method(fakes, toy_protocol, tmp_path):
    key = "s02/pose-0/front/full"
    protocol = toy_protocol()
    with pytest.MonkeyPatch.context() as patch:
        honest = fakes.ToyCapture.__init__
        patch.setattr(fakes.ToyCapture, "__init__", lambda self, **_: honest(self, damaged=key))
        outcome = run(protocol, out=tmp_path)
    assert [crash.split(": ", 1)[1].startswith(f"bad frame: {key}") for crash in outcome.crashed] == [True]


def test_two_frames_of_one_key_are_refused(fakes, toy_protocol, tmp_path, monkeypatch):
    honest = fakes.ToyCapture.frames
    monkeypatch.setattr(fakes.ToyCapture, "frames", lambda self: (*honest(self), honest(self)[0]))
    with pytest.raises(InputError, match="two frames s01/pose-0/front/olat-00"):
        run(toy_protocol(), out=tmp_path)


def test_a_changed_title_is_told_without_computing(fakes, toy_protocol, tmp_path):
    run(toy_protocol(), out=tmp_path)
    outcome = run(toy_protocol(title="Better title"), out=tmp_path)
    assert outcome.computed == 0
    told = Store(tmp_path).run().protocol
    assert told.title == "Better title" and told.columns[0].queries


def test_a_second_command_computes_only_its_methods_and_keeps_the_other_rows(fakes, toy_protocol, tmp_path):
    run(toy_protocol(), methods=["toy", "toy-nan"], out=tmp_path)
    outcome = run(toy_protocol(), methods=["toy-nan"], out=tmp_path)
    assert (outcome.computed, outcome.reused, outcome.kept, outcome.gone) == (0, 2, ("toy (seed 0)",), ())
    assert [method.name for method in Store(tmp_path).run().methods] == ["toy", "toy-nan"]
    outcome = run(toy_protocol(), methods=["oracle", "toy-nan"], seeds=[0, 1], out=tmp_path)
    assert outcome.kept == ("toy (seed 0)",)
    told = Store(tmp_path).run()
    assert [method.name for method in told.methods] == ["toy", "toy-nan", "oracle"]
    assert (told.seeds, told.seeds_of) == ((0, 1), {"toy": (0,)})
    assert len(list((tmp_path / "cells").iterdir())) == 4 + 2 + 4


def test_two_processes_on_one_run_corrupt_nothing(fakes, toy_protocol, toy_table, tmp_path):
    run(toy_protocol(), methods=["toy", "toy-nan"], seeds=range(3), out=tmp_path / "alone")
    script = tmp_path / "both.py"
    script.write_text(
        "import json, sys\n"
        "from pathlib import Path\n"
        f"sys.path.insert(0, {str(ROOT / 'fakes')!r})\n"
        "import handbench.data, handbench.methods\n"
        "from handbench.bench.run import run\n"
        "from handbench.protocols import parse\n"
        "from handbench.registry import Entry\n"
        "toys = [Entry(n, 'benchfakes:' + n.replace('-', '_'), '') for n in ('toy', 'toy-nan')]\n"
        "handbench.methods.ENTRIES += tuple(toys)\n"
        "handbench.data.ENTRIES += (Entry('toy', 'benchfakes:open_toy', ''),)\n"
        f"protocol = parse(json.loads({json.dumps(toy_table())!r}), 'toy')\n"
        "run(protocol, ['toy', 'toy-nan'], range(3), out=Path(sys.argv[1]))\n"
    )
    both = [subprocess.Popen([sys.executable, script, tmp_path / "shared"], stderr=subprocess.PIPE) for _ in range(2)]
    for process in both:
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 0, errors.decode()
    assert comparable(tmp_path / "shared") == comparable(tmp_path / "alone")
    assert not [path for path in (tmp_path / "shared").rglob("*") if path.name.endswith((".tmp", ".part"))]


def test_unknown_names_are_told_before_anything_is_made(fakes, toy_protocol, tmp_path):
    with pytest.raises(InputError, match=r"unknown method 'tay'; did you mean 'toy"):
        run(toy_protocol(), methods=["tay"], out=tmp_path / "run")
    assert not (tmp_path / "run").exists()
    with pytest.raises(InputError, match=r"unknown protocol 'quik'; did you mean 'quick'"):
        find_protocol("quik")
    with pytest.raises(InputError, match=r"metric 'pnsr'; did you mean 'psnr'"):
        run(toy_protocol(metrics=["pnsr"]), out=tmp_path)
    with pytest.raises(InputError, match="two metrics have one signature"):
        run(toy_protocol(metrics=["psnr", "psnr:region=mask"]), out=tmp_path)


def test_a_second_picture_that_differs_is_told(fakes, toy_protocol, tmp_path):
    run(toy_protocol(), methods=["toy-forgetful"], out=tmp_path)
    assert [cell["same_pixels"] for cell in cells(tmp_path)] == [False, False]


def test_losses_are_kept_with_the_prior(fakes, toy_protocol, tmp_path):
    run(toy_protocol(), out=tmp_path)
    about = Store(tmp_path).prior(cells(tmp_path)[0]["prior"])
    assert about.curve == (CurvePoint(1, {"loss": 0.5}),) and about.train_s > 0


def test_times_are_what_their_names_say(fakes, toy_protocol, tmp_path, monkeypatch):
    """A method that sleeps known times: 60 ms to pose, 20 ms to relight, and 40 ms more under an environment."""

    def pose(avatar, viewpoint):
        time.sleep(0.06)
        return fakes.PosedToy(avatar, viewpoint)

    real = fakes.ToyAvatar.draw

    def draw(avatar, viewpoint, light):
        time.sleep(0.06 if isinstance(light, Environment) else 0.02)
        return real(avatar, viewpoint, light)

    monkeypatch.setattr(fakes.ToyAvatar, "pose", pose)
    monkeypatch.setattr(fakes.ToyAvatar, "draw", draw)
    run(toy_protocol(), out=tmp_path)
    for cell in cells(tmp_path):
        new, known = cell["times"]["new_pose_ms"], cell["times"]["known_pose_ms"]
        assert set(known) <= set(new) and set(new) == ({"environment", "group", "olat"} if known else {"group"})
        for spreads, expected in ((new, {"environment": 120}), (known, {"environment": 60})):
            for kind, spread in spreads.items():
                least = expected.get(kind, 80 if spreads is new else 20)
                assert least <= spread["min"] < least + 35, kind  # a busy machine only adds, and not to every draw
    assert any(cell["times"]["known_pose_ms"] for cell in cells(tmp_path))


def test_a_viewpoint_is_posed_once_for_all_of_its_lights(fakes, toy_protocol, tmp_path, monkeypatch):
    """And posed anew for the pictures that are drawn a second time, for the warm-up and for the laws."""
    posed = Counter()
    real = fakes.ToyAvatar.pose

    def pose(avatar, viewpoint):
        posed[viewpoint.key] += 1
        return real(avatar, viewpoint)

    monkeypatch.setattr(fakes.ToyAvatar, "pose", pose)
    run(toy_protocol(), out=tmp_path)
    told = Store(tmp_path).run()
    queries = {query for column in told.protocol.columns for query in column.queries}
    viewpoints = {query.rsplit("/", 1)[0] for query in queries}
    warm_ups = sum(len(cell["times"]["new_pose_ms"]) for cell in cells(tmp_path))
    assert sum(posed.values()) == len(viewpoints) + len(queries) + warm_ups + len(cells(tmp_path))


def test_a_damaged_prior_is_trained_again(fakes, toy_protocol, tmp_path):
    protocol = toy_protocol()
    run(protocol, out=tmp_path)
    (weights,) = tmp_path.glob("priors/*/state/gain.json")
    weights.write_text("{")
    for path in (tmp_path / "cells").iterdir():
        path.unlink()
    fakes.CALLS.clear()
    assert run(protocol, out=tmp_path).crashed == ()
    assert fakes.CALLS["toy train"] == 1 and weights.read_text() == "0.5"


@pytest.mark.parametrize(("changes", "preset"), [({"metrics": ["pnsr"]}, None), ({}, "fast")])
def test_metrics_and_presets_are_checked_before_the_capture_is_generated(
    fakes, toy_protocol, tmp_path, changes, preset
):
    run(toy_protocol(), out=tmp_path / "run")
    fakes.CALLS.clear()
    for folder in ("new", "run"):  # a folder that knows the method must not hide the bad preset
        with pytest.raises(InputError, match=r"unknown (metric|preset)"):
            run(toy_protocol(**changes), preset=preset, out=tmp_path / folder)
    assert fakes.CALLS["open"] == 0 and not (tmp_path / "new").exists()


def test_lights_that_are_not_declared_are_not_asked_for(fakes, toy_protocol, tmp_path, monkeypatch):
    asked = set()
    real = fakes.ToyAvatar.draw

    def draw(avatar, viewpoint, light):
        asked.update(type(leaf) for leaf in leaves(light))
        return real(avatar, viewpoint, light)

    monkeypatch.setattr(fakes.ToyAvatar, "draw", draw)
    outcome = run(toy_protocol(), methods=["toy-directional"], out=tmp_path)
    reasons = {column: s["reason"] for (column, _), s in scores(tmp_path, "toy-directional").items()}
    assert reasons.pop("env") == "unsupported: Toy-Directional cannot draw environment lights"
    assert set(reasons.values()) == {None} and outcome.crashed == ()
    assert asked == {Directional}


def test_a_cell_tells_the_laws_measured_outside_the_clock_and_its_skips(fakes, toy_protocol, tmp_path, monkeypatch):
    real = fakes.ToyAvatar.draw

    def draw(avatar, viewpoint, light):
        if isinstance(light, Group):  # only the laws ask for groups
            note("pixels", 1000, 1000)
        return real(avatar, viewpoint, light)

    monkeypatch.setattr(fakes.ToyAvatar, "draw", draw)
    run(toy_protocol(methods=["oracle", "toy", "toy-square", "toy-nan"]), out=tmp_path)
    laws = {cell["method"]["name"]: cell["laws"] for cell in cells(tmp_path) if cell["subject"] == "s01"}
    assert laws["oracle"]["pairs"] == 0, "the truth has no answer to other lights"
    assert laws["toy"]["pairs"] == 2 and max(laws["toy"][name] for name in ("additivity", "linearity")) < 1e-6
    assert laws["toy-square"]["linearity"] > 0.1
    for cell in cells(tmp_path):
        assert "pixels" not in cell["skipped"]
        assert cell["times"]["laws_s"] >= 0


def test_recorded_pictures_too_bright_for_skin_are_a_remark_of_the_table(fakes, toy_protocol, tmp_path, monkeypatch):
    """Once for a subject, not once a method; the run goes on."""
    real = fakes.ToyCapture.observe
    bright = lambda capture, frame: replace(seen := real(capture, frame), image=seen.image * 255)  # noqa: E731
    run(toy_protocol(), methods=["toy", "oracle"], out=tmp_path / "sound")
    assert not table(tmp_path / "sound").remarks
    monkeypatch.setattr(fakes.ToyCapture, "observe", bright)
    run(toy_protocol(), methods=["toy", "oracle"], out=tmp_path / "bright")
    remarks = table(tmp_path / "bright").remarks
    told = r"\d of \d recorded pictures of s01 are too bright for skin: in s01/\S+ the median of the hand is \d+; is"
    assert len(remarks) == 2 and re.match(told, remarks[0]), remarks


def test_published_numbers_reach_the_run_without_computing_anything(fakes, toy_protocol, tmp_path):
    run(toy_protocol(), out=tmp_path)
    row = {"method": "absent", "title": "Absent", "source": "A paper", "values": {"env": {"ssim": 0.9}}}
    changes = {"metrics": ["psnr", "ssim"], "published": [row], "published_note": "No window is told."}
    run(toy_protocol(metrics=["psnr", "ssim"]), out=tmp_path)
    fakes.CALLS.clear()
    outcome = run(toy_protocol(**changes), out=tmp_path)
    assert (outcome.computed, outcome.reused) == (0, 2) and set(fakes.CALLS) == {"open", "toy create"}
    told = Store(tmp_path).run().protocol
    in_order = PublishedRecord("absent", "Absent", "A paper", {"env": (None, 0.9)})
    assert told.published == (in_order,), "in the order of the metrics"
    assert told.published_note == "No window is told."
    before = (tmp_path / "run.json").stat().st_mtime_ns
    run(toy_protocol(**changes), out=tmp_path)
    assert (tmp_path / "run.json").stat().st_mtime_ns == before
