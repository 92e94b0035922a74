"""The page of a speed study: figures, tables, and honest words where a curve does not reach."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from handbench.errors import InputError
from handbench.reports.speed import (
    cell_text,
    duration,
    goals,
    implicit_goals,
    render_speed,
    speed_section,
    write_speed_report,
)
from handbench.results.origin import Hardware, Provenance
from handbench.results.recordfile import sealed
from handbench.studies.record import SCHEMA
from handbench.studies.speed.equal_error import TimeAt, table
from handbench.studies.speed.measure import ErrorCurve, Trial
from handbench.studies.speed.record import (
    Implicit,
    ImplicitPart,
    MethodStudy,
    PartTrial,
    PoseCurve,
    PowerLaw,
    Reference,
    Residual,
    Scaling,
    SceneStudy,
    Skipped,
    SpeedRecord,
    read,
    write,
)
from handbench.studies.speed.study import GOALS


def curve(renderer: str, pose: str, *pairs: tuple[float, float], knob: str = "lights") -> ErrorCurve:
    return ErrorCurve(renderer, pose, tuple(Trial(knob, f"{e:g}", e, (t, 1.1 * t, 1.2 * t)) for t, e in pairs))


@pytest.fixture(scope="module")
def found() -> SpeedRecord:
    curves = (
        curve("handbench", "new", (0.02, 0.2), (0.05, 0.02), (0.2, 0.005)),
        curve("Mitsuba direct", "new", (0.1, 0.2), (9.0, 0.02), (40.0, 0.009), knob="samples"),
        curve("handbench", "known", (0.001, 0.05), (0.004, 0.006)),
        curve("Mitsuba direct", "known", (0.1, 0.2), (9.0, 0.02), knob="samples"),
    )
    scene = SceneStudy(
        name="lambert-sun",
        title="Lambert <sun>",
        triangles=10,
        picture=(4, 4),
        truth=Reference(9, 0.001),
        mitsuba_residual=Residual(0.002, 0.001),
        notes=(),
        learn=(),
        curves=curves,
        equal_error=table(curves),
    )
    growth = PowerLaw(exponent=0.8, error=0.05, scale=0.01, used=3)
    scaling = Scaling("lights", "Lights", (1, 16, 256), ((0.1, 0.2), (0.2, 0.3), (1.0, 1.2)), growth)
    of_method = tuple(PoseCurve(pose, curve("", pose, (0.1, 0.0), (0.05, 0.1)).points) for pose in ("new", "known"))
    methods = (
        MethodStudy("physical", "Physical", of_method),
        MethodStudy("oracle", "Oracle", reason="a calibration row"),
    )
    device = Hardware(cpu="Test CPU", cores=2, threads=2, memory_gb=8.0)
    about = Provenance("0", None, "handbench speed", device=device)
    return SpeedRecord(True, about, (scene,), GOALS, (scaling,), methods, implicit())


def implicit() -> Implicit:
    steps = tuple(PartTrial(f"{n} steps", n, 8.0 / n, 0.1 * n) for n in (10, 20, 40))
    skips = (
        Skipped("all skips", 0.0, 1.0),
        Skipped("without these four", 0.01, 4.0, 5.0),
        Skipped("plain", 0.01, 99.0, 10.0),
    )
    lights = (
        ImplicitPart("sun: strata", steps),
        ImplicitPart("sun: distant lights", (PartTrial("117 lights", 117, 0.002, 0.1),)),
    )
    growth = Scaling("rays", "Rays", (768, 3072, 12288), ((0.1,), (0.4,), (1.6,)), PowerLaw(1.0, 0.0, 1e-4, 3))
    return Implicit((ImplicitPart("grids <dense>", steps),), skips, lights, (growth,))


@pytest.fixture
def folder(found: SpeedRecord, tmp_path: Path) -> Path:
    write(tmp_path, found)
    return tmp_path


@pytest.fixture(scope="module")
def report(found: SpeedRecord, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The study's page, written once; in a folder of its own."""
    folder = tmp_path_factory.mktemp("study")
    write(folder, found)
    return write_speed_report(folder)


def test_what_is_written_is_read(folder: Path, found: SpeedRecord) -> None:
    assert read(folder) == found


def test_a_study_of_version_1_is_read(folder: Path, found: SpeedRecord) -> None:
    """It had no digest, and a ratio where a renderer was compared."""
    content = json.loads((folder / "speed.json").read_text())
    for line in content["scenes"][0]["equal_error"]:
        for cell in line["cells"]:
            if not cell.pop("compared"):
                del cell["speed_up"], cell["sign"], cell["reason"]
    del content["digest"]
    (folder / "speed.json").write_text(json.dumps({**content, "schema": 1}))
    assert read(folder) == found


def test_a_damaged_study_is_a_sentence_with_its_place(folder: Path) -> None:
    content = json.loads((folder / "speed.json").read_text())
    content["scenes"][0]["curves"][1]["points"][0]["seconds"] = "long"
    (folder / "speed.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="digest does not fit the rest: the file was changed"):
        speed_section(folder)
    (folder / "speed.json").write_text(json.dumps(sealed(content)))
    with pytest.raises(InputError, match=r'scenes\[0\].curves\[1\].points\[0\].seconds is "long", not a list; run'):
        speed_section(folder)


def test_report_needs_no_other_file(report: Path) -> None:
    page = report.read_text()
    assert page.count("data:image/png;base64,") == 4
    assert "http" not in page
    assert "Test CPU" in page
    assert "not reached" in page
    assert "Lambert &lt;sun&gt;" in page
    written = sorted(path.name for path in (report.parent / "figures").iterdir())
    names = ("error-time-lambert-sun", "implicit", "methods", "scaling")
    assert written == sorted(f"{name}.{kind}" for name in names for kind in ("png", "pdf"))


def test_same_study_gives_same_bytes(report: Path, folder: Path) -> None:
    again = write_speed_report(folder).parent
    written = {path.relative_to(again): path.read_bytes() for path in again.rglob("*") if path.is_file()}
    assert written == {path: (report.parent / path).read_bytes() for path in written} and len(written) == 9


@pytest.fixture(scope="module")
def section(found: SpeedRecord, tmp_path_factory: pytest.TempPathFactory) -> str:
    """What the page of a run shows of a study of implicit hands."""
    folder = tmp_path_factory.mktemp("implicit")
    write(folder, replace(found, scenes=(), scaling=(), methods=()))
    made = speed_section(folder)
    assert made is not None
    return made


def test_section_is_a_fragment_or_nothing(section: str, tmp_path: Path) -> None:
    assert "<html" not in section and "<h2" in section
    assert speed_section(tmp_path / "nowhere") is None


def test_study_of_a_newer_version_is_refused(folder: Path, found: SpeedRecord) -> None:
    content = json.loads((folder / "speed.json").read_text())
    (folder / "speed.json").write_text(json.dumps({**content, "schema": SCHEMA + 1}))
    with pytest.raises(InputError, match="run 'handbench speed' again"):
        speed_section(folder)


def test_implicit_hands_have_their_goals_and_tables(section: str, found: SpeedRecord) -> None:
    together, plain = implicit_goals(found.implicit)
    assert not together[0] and "4 times the time of all skips, goal 5 times" in together[1]
    assert plain[0] and "99 times" in plain[1]
    assert "grids &lt;dense&gt;" in section and "117 lights" in section and "0.2 mm" in section
    assert found.implicit is not None and found.implicit.directions[0].power == pytest.approx(-1.0)
    assert found.implicit.directions[1].power is None


def test_a_study_without_implicit_hands_is_read(folder: Path, found: SpeedRecord) -> None:
    write(folder, replace(found, implicit=None, scaling=()))  # two figures are enough
    content = json.loads((folder / "speed.json").read_text())
    del content["implicit"]
    (folder / "speed.json").write_text(json.dumps(sealed(content)))
    assert read(folder).implicit is None and implicit_goals(None) == []
    section = speed_section(folder)
    assert section is not None and "Implicit hands" not in section


def test_goals_are_judged_on_what_was_reached(found: SpeedRecord) -> None:
    new, known = goals(found)
    assert new[0] and "goal 3 times" in new[1]
    assert not known[0] and "not reached" in known[1]  # Mitsuba's known pose stops at 2 %


def test_cells_say_what_they_know() -> None:
    cell = TimeAt(0.01, 0.25, bound=True, compared=True, speed_up=5.0, sign="<=")
    assert cell_text(cell) == "≤ 250 ms (≤ 5×)"
    assert cell_text(replace(cell, seconds=None)) == "not reached"
    assert [duration(t) for t in (2.5, 0.0123, 4e-5)] == ["2.5 s", "12.3 ms", "40 µs"]


def test_terminal_shows_every_table(found: SpeedRecord) -> None:
    out = io.StringIO()
    Console(width=140, file=out).print(render_speed(found))
    text = out.getvalue()
    for part in ("Lambert <sun>", "0.80 ± 0.05", "Physical", "a calibration row", "exact"):
        assert part in text
