"""An audit finds a sound run sound, and every way of tampering with it breaks the check that is there for it."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import handbench.studies.audit.evidence as evidence_module
from handbench.bench.narrowing import narrowed
from handbench.bench.protocol import Selection
from handbench.bench.run import find_protocol, run
from handbench.cli import main
from handbench.data.exr import read_exr, write_exr
from handbench.errors import Damaged, InputError
from handbench.methods.oracle import OracleAvatar
from handbench.reports import table
from handbench.results.recordfile import sealed
from handbench.scene import Directional, Environment, Point, Prediction, Query
from handbench.settings import Setting
from handbench.studies.audit import CHECKS, audit, injection, pixels, separation
from handbench.studies.audit.evidence import Evidence, gather

SMALL = [Setting.parse(f"physical:{one}") for one in ("texture=64", "fit_frames=8", "roughness=0.3,0.5")]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the smoke protocol, one method with other settings than its preset's."""
    folder = tmp_path_factory.mktemp("sound") / "run"
    run(
        find_protocol("smoke"),
        methods=["oracle", "mean", "physical"],
        out=folder,
        command=["handbench", "run", "smoke"],
        settings=SMALL,
    )
    return folder


@pytest.fixture
def copy(sound: Path, tmp_path: Path) -> Path:
    """The run, to be tampered with."""
    return Path(shutil.copytree(sound, tmp_path / "run"))


def verdict(folder: Path, check: str) -> tuple[bool | None, str]:
    """What a single check says of a run."""
    evidence = gather(folder, table, None, None)
    found = next(v for v in _only(check, evidence))
    return found.holds, found.detail


def _only(check: str, evidence: Evidence) -> Any:
    from handbench.studies.audit import _tried

    yield _tried(check, CHECKS[check], evidence)


def cell_of(folder: Path, method: str, subject: str = "s01") -> Path:
    for path in (folder / "cells").glob("*.json"):
        cell = json.loads(path.read_text())
        if (cell["method"]["name"], cell["subject"]) == (method, subject):
            return path
    raise LookupError(method)


def edit(path: Path, change: Callable[[dict], None]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(sealed(content)))


def test_a_sound_run_holds_and_is_not_touched(sound: Path, capsys: pytest.CaptureFixture) -> None:
    before = {path: path.read_bytes() for path in sound.rglob("*") if path.is_file()}
    assert main(["audit", str(sound)]) == 0
    out, _ = capsys.readouterr()
    lines = {line[:22].strip(): line[22:].strip() for line in out.splitlines()}
    assert list(lines) == list(CHECKS)
    assert all(line.startswith("holds") for line in lines.values()), out
    assert "all perfect" in lines["oracle perfect"] and "of the peak explain" in lines["drawn again"]
    assert "non-finite" in lines["NaN in a prediction"]
    after = {path: path.read_bytes() for path in sound.rglob("*") if path.is_file()}
    assert after.pop(sound / "audit.json"), "what reports tell of it"
    assert after == before
    assert main(["audit", str(sound), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [each["check"] for each in told] == list(CHECKS) and {each["verdict"] for each in told} == {"holds"}


# -- tampering ------------------------------------------------------------------------------------------------------


def tampered_score(folder: Path) -> None:
    """A better score than the picture has."""
    edit(
        cell_of(folder, "physical"),
        lambda cell: [s.update(values=[v + 0.05 for v in s["values"]]) for s in cell["scores"]],
    )


def oracle_not_perfect(folder: Path) -> None:
    edit(cell_of(folder, "oracle"), lambda cell: cell["scores"][0]["values"].__setitem__(0, 99.9))


def oracle_without_value(folder: Path) -> None:
    def change(cell: dict) -> None:
        others = len(cell["metrics"]) - 1
        cell["scores"][0]["values"][0] = None
        cell["scores"][0]["reasons"] = ["unsupported: no reason", *[None] * others]

    edit(cell_of(folder, "oracle"), change)


def lost_score(folder: Path) -> None:
    edit(cell_of(folder, "mean"), lambda cell: cell["scores"].pop())


def additional_score(folder: Path) -> None:
    edit(cell_of(folder, "mean"), lambda cell: cell["scores"].append({**cell["scores"][0], "column": "another"}))


def lost_cell(folder: Path) -> None:
    cell_of(folder, "mean").unlink()


def dropped_query(folder: Path) -> None:
    """A hard query that is no longer told, nor scored."""
    plan = json.loads((folder / "run.json").read_text())
    gone = plan["protocol"]["columns"][0]["queries"].pop()
    (folder / "run.json").write_text(json.dumps(sealed(plan)))
    for path in (folder / "cells").glob("*.json"):
        edit(path, lambda cell: cell.update(scores=[s for s in cell["scores"] if s["query"] != gone]))


def other_preset(folder: Path) -> None:
    edit(folder / "run.json", lambda plan: plan["methods"][2].update(preset="standard"))


def swapped_cells(folder: Path) -> None:
    """The cell of one subject passed off as another's."""
    edit(cell_of(folder, "physical", "s02"), lambda cell: cell.update(seed=7))


def other_signature(folder: Path) -> None:
    def change(plan: dict) -> None:
        metric = plan["protocol"]["metrics"][0]
        metric["signature"] = metric["signature"].replace("v1", "v0")

    edit(folder / "run.json", change)


def no_start(folder: Path) -> None:
    edit(cell_of(folder, "physical"), lambda cell: cell["provenance"].pop("started"))


def no_packages(folder: Path) -> None:
    edit(folder / "run.json", lambda plan: plan["provenance"].update(packages={}))


def other_pixels(folder: Path) -> None:
    edit(cell_of(folder, "mean"), lambda cell: cell.update(same_pixels=False))


def edited_picture(folder: Path) -> None:
    """One pixel of one picture: too little for the score to tell, enough for the pixels. Its digest is made to fit."""
    cell = cell_of(folder, "physical")
    path = sorted((folder / "predictions" / cell.stem).iterdir())[0]
    channels = read_exr(path)
    row, column = np.argwhere(channels["A"] > 0.5)[0]
    channels["R"][row, column] *= 1.01
    write_exr(path, {name: pixels.astype(np.float16) for name, pixels in channels.items()})
    digest, query = hashlib.sha256(path.read_bytes()).hexdigest(), path.stem.replace("__", "/")
    edit(cell, lambda cell: cell["predictions"].update({query: digest}))


def flipped_bit_of_a_picture(folder: Path) -> None:
    path = sorted((folder / "predictions" / cell_of(folder, "physical").stem).iterdir())[0]
    path.write_bytes(path.read_bytes()[:-1] + b"!")


def lost_picture(folder: Path) -> None:
    shutil.rmtree(folder / "predictions" / cell_of(folder, "mean").stem)


def worst_of_all(folder: Path) -> None:
    """Scores under which every method is below the floor."""
    for subject in ("s01", "s02"):
        edit(
            cell_of(folder, "physical", subject),
            lambda cell: [s.update(values=[-1.0] * len(s["values"])) for s in cell["scores"]],
        )


def nothing_shared(folder: Path) -> None:
    edit(folder / "run.json", lambda plan: plan["protocol"]["columns"][0].update(shares=[]))


@pytest.mark.parametrize(
    ("tamper", "check", "words"),
    [
        (tampered_score, "scored again", "physical s01 seed 0: PSNR of .* is stored as .*, its picture gives"),
        (oracle_not_perfect, "oracle perfect", "is 99.9, perfect is 100"),
        (oracle_without_value, "oracle perfect", "no reason, perfect is 100"),
        (lost_score, "coverage", "mean s01 seed 0 lacks scores"),
        (additional_score, "coverage", "mean s01 seed 0 has too many scores"),
        (lost_cell, "coverage", "is missing"),
        (dropped_query, "coverage", "other queries than the protocol selects"),
        (other_preset, "keys", "2 of 6 cells were computed with other code"),
        (swapped_cells, "keys", "physical s02 seed 7 is not of the run's"),
        (other_signature, "signatures", "is of another version of 'psnr'"),
        (no_start, "provenance", "physical s01 seed 0 does not tell its started"),
        (no_packages, "provenance", "run.json does not tell its packages"),
        (other_pixels, "timed are scored", "mean s01 seed 0 drew other pixels"),
        (edited_picture, "drawn again", "physical s01 seed 0 draws .* differently"),
        (flipped_bit_of_a_picture, "scored again", r"\.exr is damaged: it was changed after it was written"),
        (lost_picture, "drawn again", "does not exist"),
        (worst_of_all, "mean is the floor", "no method is above Mean predictor anywhere"),
        (nothing_shared, "train and test apart", "unseen-segment scores a subject that training saw"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_tampering_breaks_its_check(copy: Path, tamper: Callable[[Path], None], check: str, words: str) -> None:
    import re

    tamper(copy)
    holds, detail = verdict(copy, check)
    assert holds is False and re.search(words, detail), detail


def test_a_person_of_another_capture_is_no_stranger(sound: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from handbench.data.openstage.population import PEOPLE

    assert CHECKS["strangers"](gather(sound, table, None, None))[0] is True
    monkeypatch.setitem(PEOPLE, "openscans", range(1, 3))
    holds, detail = CHECKS["strangers"](gather(sound, table, None, None))
    assert holds is False and detail == "s02 is s02 of openscans, which methods may train on"


@pytest.mark.parametrize(
    ("tamper", "words"),
    [
        (lambda cell: cell["scores"].append(cell["scores"][0]), "scores holds .* twice"),
        (lambda cell: cell["scores"][0]["values"].__setitem__(0, None), "scores.* holds 0 reasons for"),
        (lambda cell: cell["times"].update(train_s=-1.0), "times.train_s is -1.0, not a time"),
    ],
)
def test_a_cell_that_contradicts_itself_is_refused(copy: Path, tamper: Callable[[dict], None], words: str) -> None:
    edit(cell_of(copy, "mean"), tamper)
    with pytest.raises(Damaged, match=words):
        gather(copy, table, None, None)


def test_a_changed_value_is_refused_by_its_digest(copy: Path) -> None:
    path = cell_of(copy, "mean")
    cell = json.loads(path.read_text())
    cell["scores"][0]["values"][0] += 1e-9
    path.write_text(json.dumps(cell))
    with pytest.raises(Damaged, match=rf"^{path} is damaged: digest does not fit the rest"):
        gather(copy, table, None, None)


def test_a_broken_check_gives_exit_code_1(copy: Path, capsys: pytest.CaptureFixture, monkeypatch) -> None:
    monkeypatch.setattr("handbench.studies.audit.CHECKS", {"oracle perfect": CHECKS["oracle perfect"]})
    oracle_not_perfect(copy)
    assert main(["audit", str(copy)]) == 1
    assert "BROKEN" in capsys.readouterr().out


def test_a_method_below_the_floor_is_named(copy: Path) -> None:
    def change(cell: dict) -> None:
        for score in cell["scores"]:
            if score["column"] == "environment":
                score["values"] = [0.0] * len(score["values"])

    edit(cell_of(copy, "physical"), change)
    holds, detail = verdict(copy, "mean is the floor")
    assert holds is True and detail.endswith("in environment (PSNR), environment (SSIM)"), detail
    assert "Physical BRDF" in detail


def test_without_calibration_rows_there_is_nothing_to_tell(sound: Path, tmp_path: Path) -> None:
    again = run(find_protocol("smoke"), ["physical"], out=tmp_path / "run", reuse=[sound], settings=SMALL)
    assert again.computed == 0
    for check, words in (("oracle perfect", "no oracle"), ("mean is the floor", "no mean predictor")):
        holds, detail = verdict(tmp_path / "run", check)
        assert holds is None and words in detail


def test_a_method_that_is_not_registered_is_left_out_where_it_would_be_needed(copy: Path) -> None:
    """As a prediction folder is."""
    edit(copy / "run.json", lambda plan: plan["methods"][2].update(name="elsewhere"))
    for subject in ("s01", "s02"):
        edit(cell_of(copy, "physical", subject), lambda cell: cell["method"].update(name="elsewhere"))
    for check, words in (("keys", "all 4 come out again"), ("drawn again", "elsewhere (not registered here)")):
        holds, detail = verdict(copy, check)
        assert holds is True and words in detail and "not registered here" in detail
    assert verdict(copy, "scored again")[0] is True


def test_a_method_that_changes_what_it_is_given_is_named_and_spoils_no_other(
    sound: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest = OracleAvatar.relight

    def relight(self: OracleAvatar, query: Query) -> Prediction:
        answer = honest(self, query)
        query.mesh.vertices.flags.writeable = True
        query.mesh.vertices[:] = 0.0
        return answer

    monkeypatch.setattr(OracleAvatar, "relight", relight)
    holds, detail = verdict(sound, "drawn again")
    assert holds is False and "oracle s01 seed 0 changed what it was given: the mesh of s01/" in detail
    assert "physical" not in detail and "mean" not in detail


# -- what compares --------------------------------------------------------------------------------------------------


def test_leaks_are_found_whatever_they_are_called(sound: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A protocol that trains on scored lights, poses and subjects, past the own check of `select`."""
    evidence = gather(sound, table, None, None)
    assert separation.apart(evidence)[0] is True
    everything = replace(evidence.protocol, train=Selection(), trained=("s01", "s02"))
    monkeypatch.setattr(evidence_module, "select", lambda *_: evidence.selected)
    leaky = replace(evidence, protocol=everything)
    holds, detail = separation.apart(leaky)
    assert holds is False and "pose that training saw" in detail
    lights = replace(evidence.protocol, train=Selection(segments=("train",), lightings=("olat-*",)))
    holds, detail = separation.apart(replace(evidence, protocol=lights))
    assert holds is False and "unseen-light scores a light that training saw (olat-06" in detail


def test_lights_are_one_by_value() -> None:
    sun = Directional(np.array([0.0, 0.6, 0.8]), np.ones(3))
    nearly = Directional(np.array([0.0, 0.6003, 0.7997751]), np.full(3, 9.0))
    other = Directional(np.array([0.0, 0.61, 0.7924014]), np.ones(3))
    sky = np.random.default_rng(0).random((4, 8, 3))
    assert separation._is_among(sun, [nearly]) and not separation._is_among(sun, [other])
    assert separation._is_among(Environment("a", sky), [Environment("b", 3.0 * sky)])
    assert not separation._is_among(Environment("a", sky), [Environment("a", sky[::-1])])
    assert separation._is_among(Environment("a", sky), [Environment("a", sky[:2])]), "of another size: by name"
    lamp = Point(np.ones(3), np.ones(3))
    assert separation._is_among(lamp, [Point(np.ones(3), np.zeros(3))]) and not separation._is_among(lamp, [sun])


def test_half_floats_explain_their_rounding_and_no_more() -> None:
    rng = np.random.default_rng(0)
    image = (rng.random((40, 40, 3)) * 10.0 ** rng.uniform(-7, 3, (40, 40, 1))).astype(np.float32)
    drawn = Prediction(image, rng.random((40, 40)))
    kept = Prediction(image.astype(np.float16), drawn.alpha.astype(np.float16))
    assert pixels._beyond_half(drawn, kept) <= 1.0
    moved = image.copy()
    moved[3, 4] = moved[3, 4] * 1.002 + 0.05
    assert pixels._beyond_half(Prediction(moved, drawn.alpha), kept) > 1.0
    moved[0, 0] = np.nan
    assert pixels._beyond_half(Prediction(moved, drawn.alpha), kept) == float("inf")


def test_a_metric_that_depends_on_company_is_found(sound: Path) -> None:
    evidence = gather(sound, table, None, None)
    signature, metric = next(iter(evidence.metrics.items()))

    class Batch:
        """Scores that drift with the place in the batch."""

        title = "Drift"

        def __call__(self, pairs: list) -> list:
            return [replace(score, value=score.value + 1e-3 * i) for i, score in enumerate(metric(pairs))]

    evidence.__dict__["metrics"] = {signature: Batch()}
    holds, detail = CHECKS["image order"](evidence)
    assert holds is False and "Drift of" in detail


def test_a_table_that_depends_on_the_order_of_shards_is_found(sound: Path) -> None:
    def first_cell_wins(folder: Path) -> Any:
        made = table(folder)
        first = json.loads((folder / "run.json").read_text())["cells"][0]
        return replace(made, title=first)

    assert CHECKS["shard order"](gather(sound, table, None, None))[0] is True
    assert CHECKS["shard order"](gather(sound, first_cell_wins, None, None))[0] is False


@pytest.mark.parametrize(
    "stage", [stage for stage in injection.STAGES if stage.spoils != 0], ids=lambda stage: stage.name
)
def test_a_table_that_hides_nan_is_found(sound: Path, stage: injection.Injection) -> None:
    """A table that fills gaps with what it has, as a mean that skips NaN does."""

    def filled(folder: Path) -> Any:
        made = table(folder)
        rows = [
            replace(row, cells=tuple(replace(cell, covered=cell.expected) for cell in row.cells)) for row in made.rows
        ]
        return replace(made, rows=tuple(rows))

    holds, detail = stage.check(gather(sound, filled, None, None))
    assert holds is False and "values of" in detail


def test_a_part_of_a_protocol_with_other_settings_is_planned_again(tmp_path: Path) -> None:
    changes = [Setting.parse("phong:texture=32"), Setting.parse("phong:roughness=0.3, 0.5")]
    run(narrowed(find_protocol("smoke"), ("s02",), 1), ["oracle", "phong"], out=tmp_path, settings=changes)
    assert gather(tmp_path, table, None, None).protocol.subjects == ("s02",)
    assert verdict(tmp_path, "keys")[0] is True
    edit(tmp_path / "run.json", lambda plan: plan["methods"][1]["config"].update(texture=64))
    assert verdict(tmp_path, "keys")[0] is False


# -- bad input ------------------------------------------------------------------------------------------------------


def test_bad_input_is_one_sentence(copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main(["audit", str(tmp_path / "nowhere")]) == 2
    assert "holds no readable run.json" in capsys.readouterr().err
    assert main(["audit", str(copy), "--protocol", "quick"]) == 2
    assert "protocol quick@2 is not the one" in capsys.readouterr().err
    edit(copy / "run.json", lambda plan: plan["capture"].update(digest="0" * 16))
    assert main(["audit", str(copy)]) == 2
    assert "was run on 0000000000000000" in capsys.readouterr().err
    edit(copy / "run.json", lambda plan: plan["protocol"].update(name="mine"))
    with pytest.raises(InputError, match=r"unknown protocol 'mine'.*give its file with --protocol"):
        list(audit(copy, table))
