"""Prediction folders: pictures from elsewhere score as they would here, and whatever is wrong with them is told."""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from flat import flat_cells
from PIL import Image

import handbench.methods
from handbench.bench.resolving import resolve
from handbench.bench.run import find_protocol
from handbench.bench.score import score, template
from handbench.cli import main
from handbench.data.exr import rgb, write_exr
from handbench.data.predictions import Asked, Unfit, read_folder
from handbench.data.predictions.picture import read_picture
from handbench.errors import InputError, StorageError
from handbench.method import Recording
from handbench.registry import CAPTURES, METHODS
from handbench.scene.colour import srgb

KEY = "s01/pose-2/front/group-0"  # one of the toy protocol's queries


def draw(folder: Path, key: str, image: np.ndarray, alpha: np.ndarray, dtype: type = np.float32, **channels) -> Path:
    path = folder / f"{key}.exr"
    path.parent.mkdir(parents=True, exist_ok=True)
    write_exr(path, {**rgb(image, dtype=dtype), "A": alpha.astype(dtype), **channels})
    return path


def complete(folder: Path, **changes: object) -> None:
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    path.write_text(json.dumps({**manifest, "method": "theirs", "title": "Theirs", **changes}))


@pytest.fixture
def protocol(fakes, toy_protocol):
    return toy_protocol(methods=["oracle", "toy"])


@pytest.fixture(scope="module")
def untouched(tmp_path_factory) -> Path:
    """Where the first test makes the folder that all get copies of."""
    return tmp_path_factory.mktemp("untouched") / "theirs"


@pytest.fixture
def folder(protocol, untouched, tmp_path) -> Path:
    """A folder that is fit: the truth, halved."""
    if not untouched.exists():
        template(protocol, untouched)
        complete(untouched)
        capture = CAPTURES.load("toy")(size="tiny")
        for frames in resolve(protocol, capture.frames()).scored.values():
            for frame in frames:
                seen = capture.observe(frame)
                draw(untouched, frame.key, 0.5 * seen.image, seen.alpha)
    return Path(shutil.copytree(untouched, tmp_path / "theirs"))


@pytest.fixture
def problems(protocol, folder, tmp_path) -> Callable[..., list[str]]:
    """What is told of the folder; nothing may be written."""

    def told(**options) -> list[str]:
        out = tmp_path / "run"
        with pytest.raises(Unfit) as found:
            score(protocol, folder, out, **options)
        assert not out.exists() and "nothing was written" in str(found.value) and "\n" not in str(found.value)
        return found.value.lines

    return told


def rows(out: Path) -> dict[str, list[dict]]:
    """The scores of a run by method."""
    found: dict[str, list[dict]] = {}
    for cell in flat_cells(out):
        found.setdefault(cell["method"]["name"], []).extend(cell["scores"])
    return found


def test_half_the_truth_scores_as_half_the_truth(protocol, folder, tmp_path):
    outcome = score(protocol, folder, tmp_path / "run")
    scores = rows(outcome.folder)
    assert set(scores) == {"oracle", "theirs"} and not outcome.crashed
    capture = CAPTURES.load("toy")(size="tiny")
    frames = {frame.key: frame for frame in capture.frames()}
    psnr = handbench.metrics.metric("psnr")
    for each in scores["theirs"]:
        seen = capture.observe(frames[each["query"]])
        (expected,) = psnr([handbench.metrics.Pair(0.5 * seen.image, seen.image, seen.alpha)])
        assert each["value"] == pytest.approx(expected.value, abs=1e-9)
    assert {each["value"] for each in scores["oracle"]} == {100.0}
    told = json.loads((outcome.folder / "run.json").read_text())["methods"]
    assert [method["fidelity"] for method in told][1] == "predictions from a folder, not run here"


def test_what_was_drawn_here_and_written_scores_the_same_to_the_last_digit(tmp_path):
    """The mean predictor on the shipped light stage, and its pictures from a folder, side by side in one run."""
    smoke = replace(find_protocol("smoke"), methods=("oracle", "mean"), metrics=("psnr", "ssim"))
    capture = CAPTURES.load("openstage")(size="mini")
    selected = resolve(smoke, capture.frames())
    folder = tmp_path / "folder"
    template(smoke, folder)
    complete(folder)
    prior = METHODS.load("mean")().train(Recording(selected.train, capture.observe), 0)
    for subject in smoke.subjects:
        avatar = prior.personalise(Recording([f for f in selected.enrol if f.subject == subject], capture.observe), 0)
        for frame in {f.key: f for frames in selected.scored.values() for f in frames if f.subject == subject}.values():
            drawn = avatar.relight(frame.query)
            draw(folder, frame.key, drawn.image, drawn.alpha)
    scores = rows(score(smoke, folder, tmp_path / "scored").folder)
    values = {
        name: {(s["column"], s["query"], s["metric"]): s["value"] for s in found} for name, found in scores.items()
    }
    assert set(values) == {"oracle", "mean", "theirs"} and values["theirs"] == values["mean"] != {}


def test_a_second_time_nothing_is_computed_and_new_pictures_are(protocol, folder, tmp_path):
    first = score(protocol, folder, tmp_path / "run")
    assert (score(protocol, folder, tmp_path / "run").computed, first.computed) == (0, 4)
    draw(folder, KEY, np.full((8, 8, 3), 0.25), np.ones((8, 8)))
    assert score(protocol, folder, tmp_path / "run").computed == 2  # both subjects of the folder, not the oracle


def test_the_template_asks_for_exactly_what_is_scored(protocol, tmp_path):
    place = tmp_path / "new"
    count = template(protocol, place, images=True)
    asked = json.loads((place / "asked" / "queries.json").read_text())
    capture = CAPTURES.load("toy")(size="tiny")
    selected = resolve(protocol, capture.frames())
    frames = {frame.key: frame for frame in capture.frames()}
    scored = {frame.key for frames in selected.scored.values() for frame in frames}
    assert {row["key"] for row in asked["queries"]} == scored and len(asked["queries"]) == count == len(scored)
    assert [row["key"] for row in asked["train"]] == [frame.key for frame in selected.train]
    assert [row["key"] for row in asked["enrol"]] == [frame.key for frame in selected.enrol]
    for row in asked["queries"]:
        frame, camera, pose = frames[row["key"]], asked["cameras"][row["camera"]], asked["poses"][row["pose"]]
        assert camera["K"] == frame.camera.K.tolist() and (camera["width"], camera["height"]) == (8, 8)
        assert camera["world_to_camera"] == frame.camera.world_to_camera.tolist()
        mesh = np.load(place / pose["mesh"])
        assert mesh["vertices"].tobytes() == frame.mesh.vertices.tobytes()
        assert np.array_equal(mesh["uv_faces"], frame.mesh.topology.uv_faces)
        light = asked["lights"][row["light"]]
        assert light["type"] == ("environment" if frame.kind == "environment" else "directional")
        if light["type"] == "directional":
            assert light["direction"] == frame.light.direction.tolist()
    shown = {
        path.relative_to(place / "asked" / "images").with_suffix("").as_posix()
        for path in place.rglob("images/**/*.exr")
    }
    assert shown == {frame.key for frame in (*selected.train, *selected.enrol)} and not shown & scored
    assert (place / "asked" / "environments" / "0.exr").is_file()


@pytest.fixture
def strict(fakes, toy_protocol):
    """A protocol that gives pictures, masks and poses, and asks for the light as enrolled."""
    own = {"name": "own", "title": "Own", "subjects": "unseen", "segments": ["held-out"], "kinds": ["full"]}
    group = {"name": "group", "title": "Group", "subjects": "unseen", "segments": ["held-out"], "kinds": ["group"]}
    columns = [{**own, "shares": ["light"], "light": "as enrolled"}, {**group, "shares": ["light"]}]
    enrol = {"segments": ["train"], "kinds": ["full"], "gives": ["image", "pose"]}
    return toy_protocol(methods=["oracle"], column=columns, enrol=enrol)


def test_the_template_tells_of_enrolment_what_it_gives_and_of_queries_what_a_method_is_told(strict, tmp_path):
    template(strict, tmp_path / "new", images=True)
    asked = json.loads((tmp_path / "new" / "asked" / "queries.json").read_text())
    unseen = [row for row in asked["enrol"] if row["subject"] == "s02"]
    assert unseen and {row["lighting"] for row in unseen} == {"light-0"}
    for row in unseen:
        assert asked["lights"][row["light"]] == {"type": "unknown", "name": "light-0"}
        assert asked["cameras"][row["camera"]].keys() == {"name", "width", "height"}
        assert asked["poses"][row["pose"]].keys() == {"name", "joints", "rotation", "translation"}
        shown = OpenEXR.File(str(tmp_path / "new" / "asked" / "images" / f"{row['key']}.exr"), separate_channels=True)
        assert set(shown.channels()) == {"R", "G", "B"}
    assert not list((tmp_path / "new" / "asked" / "meshes").rglob("s02/*"))
    lights = {row["key"]: asked["lights"][row["light"]]["type"] for row in asked["queries"]}
    assert lights["s02/pose-2/front/as-enrolled"] == "unknown" and lights["s02/pose-2/front/group-0"] != "unknown"
    for row in asked["queries"]:
        assert "mesh" not in asked["poses"][row["pose"]] and "kind" not in row
        assert len(asked["cameras"][row["camera"]]["K"]) == 3
    told = (tmp_path / "new" / "asked" / "queries.json").read_text()
    assert "s02/pose-0/front/full" not in told and "s02/pose-2/front/full" not in told


@pytest.mark.parametrize(
    ("capture", "segment", "gives", "archived"),
    [
        ("openphone", "scan", ["image", "alpha", "camera", "depth", "keypoints"], {"depth", "keypoints"}),
        ("openscans", "scan", ["image", "camera", "normal", "scan"], {"normal", "scan_vertices", "scan_faces"}),
        ("openscans", "scan", ["image", "camera"], set()),
    ],
)
def test_the_template_hands_over_what_else_was_recorded_if_it_is_given(
    capture, segment, gives, archived, toy_protocol, tmp_path
):
    opened = CAPTURES.load(capture)(size="mini")
    frames = [frame for frame in opened.frames() if frame.segment == segment]
    people = sorted({frame.subject for frame in frames})
    one = {"name": "own", "title": "Own", "subjects": "unseen", "segments": [segment]}
    protocol = toy_protocol(
        capture=capture,
        size="mini",
        subjects={"trained": people[:1], "unseen": people[1:]},
        train={"segments": [segment]},
        enrol={"segments": [segment], "gives": gives},
        column=[{**one, "shares": ["subject", "pose", "light"], "limit": 1}],
        methods=["oracle"],
    )
    place = tmp_path / "new"
    template(protocol, place, images=True)
    asked = json.loads((place / "asked" / "queries.json").read_text())
    moments = {frame.key: frame.moment for frame in frames}
    row = next(row for row in asked["enrol"] if row["subject"] == people[1])
    frame = next(frame for frame in frames if frame.viewpoint.key == row["key"].rsplit("/", 1)[0])
    assert row.get("moment") == moments[frame.key]
    beside = place / "asked" / "images" / f"{row['key']}.npz"
    assert beside.is_file() == bool(archived)
    if archived:
        found, seen = np.load(beside), opened.observe(frame)
        assert set(found.files) == archived
        for name in archived & {"depth", "keypoints", "normal"}:
            assert np.array_equal(found[name], getattr(seen, name))
        if seen.scan is not None and "scan_vertices" in archived:
            assert np.array_equal(found["scan_vertices"], seen.scan.vertices)


def test_pictures_in_the_light_as_enrolled_are_scored(strict, tmp_path):
    place = tmp_path / "theirs"
    template(strict, place)
    complete(place)
    capture = CAPTURES.load("toy")(size="tiny")
    for name, frames in resolve(strict, capture.frames()).scored.items():
        for frame in frames:
            seen = capture.observe(frame)
            key = f"{frame.viewpoint.key}/as-enrolled" if name == "own" else frame.key
            draw(place, key, seen.image, seen.alpha)
    scores = rows(score(strict, place, tmp_path / "run").folder)["theirs"]
    assert len(scores) == 4 and {each["value"] for each in scores} == {100.0}


def test_meshes_without_uvs_are_written_once_and_beside_those_with_them(fakes, toy_protocol, tmp_path):
    enrol = {"segments": ["train"], "kinds": ["full"], "gives": ["image", "alpha", "camera", "pose", "mesh", "light"]}
    template(toy_protocol(methods=["oracle"], enrol=enrol), tmp_path / "new")
    asked = json.loads((tmp_path / "new" / "asked" / "queries.json").read_text())
    paths = {
        name: {asked["poses"][row["pose"]]["mesh"] for row in asked[name]} for name in ("train", "enrol", "queries")
    }
    assert not paths["train"] & (paths["enrol"] | paths["queries"])
    assert all("uvs" in np.load(tmp_path / "new" / path) for path in paths["train"])
    assert not any("uvs" in np.load(tmp_path / "new" / path) for path in paths["enrol"] | paths["queries"])
    meshes = list((tmp_path / "new" / "asked" / "meshes").rglob("*.npz"))
    assert len(meshes) == len(paths["train"] | paths["enrol"] | paths["queries"])


def test_the_renderer_of_the_document_draws_what_is_asked(protocol, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    template(protocol, tmp_path / "theirs")
    complete(tmp_path / "theirs")
    text = (Path(__file__).parents[2] / "docs" / "prediction-folders.md").read_text()

    def drawn(mesh, camera, light, subject):
        return np.zeros((camera["height"], camera["width"], 3), np.float32), np.ones((8, 8), np.float32)

    exec(text.split("```python\n")[1].split("```")[0], {"draw": drawn})
    assert not score(protocol, tmp_path / "theirs", tmp_path / "run").crashed


def test_a_template_is_no_answer_yet(protocol, tmp_path):
    template(protocol, tmp_path / "new")
    with pytest.raises(Unfit) as found:
        score(protocol, tmp_path / "new", tmp_path / "run")
    lines = found.value.lines
    assert lines[0].startswith("manifest (2): ") and "  method is ''; give a text" in lines
    assert any(line.startswith("missing (10): no picture for these queries") for line in lines)


def test_a_template_on_a_full_disk_is_one_sentence_and_leaves_nothing(protocol, tmp_path, monkeypatch):
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(StorageError, match=r"the disk is full, .*new cannot be written; free some space"):
        template(protocol, tmp_path / "new")
    assert not list(tmp_path.iterdir())


def test_a_template_overwrites_nothing(protocol, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").write_text("precious")
    with pytest.raises(InputError, match="exists and is not empty; name a new folder"):
        template(protocol, tmp_path / "full")
    assert [path.name for path in tmp_path.iterdir()] == ["full"]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"protocol": "toy@2"}, "protocol is 'toy@2', expected 'toy@1'"),
        ({"protocol_digest": "0" * 64}, f"protocol_digest is '{'0' * 64}', expected '"),
        ({"capture_digest": "other"}, "capture_digest is 'other', expected 'toy-digest'"),
        ({"version": 2}, "version is 2, this handbench reads 1"),
        ({"format": "pictures"}, "format is 'pictures', expected \"handbench predictions\""),
        (
            {"colour": "sRGB"},
            'colour is \'sRGB\', expected "linear Rec. 709, premultiplied over black" (EXR) or "sRGB, st',
        ),
        ({"method": "../../etc"}, "method is '../../etc'; use up to 64 letters"),
        ({"method": 3}, "method is 3; give a text"),
        ({"title": " "}, "title is ' '; give a text"),
        ({"seed": -1}, "seed is -1; give a whole number, at least 0"),
        ({"seed": True}, "seed is True; give a whole number, at least 0"),
        ({"note": ["a"]}, "note is ['a']; give a text"),
        ({"colour": ["sRGB"]}, "colour is ['sRGB'], expected "),
        ({"licence": "MIT"}, "'licence' is not known; the keys are format, version, "),
    ],
)
def test_a_manifest_that_does_not_fit(folder, problems, change, told):
    complete(folder, **change)
    lines = problems()
    assert lines[0].startswith("manifest (1): ") and lines[1].startswith(f"  {told}") and len(lines) == 2


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "  it is no JSON (Expecting value"),
        ("[]", "  it holds no JSON object"),
        ("[" * 100_000, "  it is no JSON ("),
        ("\xff", "  it is no JSON ("),
        ('{"seed": 1, "seed": 2}', "  'seed' is given twice"),
        (None, "  it cannot be read (No such file or directory)"),
    ],
)
def test_a_manifest_that_cannot_be_read(folder, problems, text, told):
    (folder / "manifest.json").unlink()
    if text is not None:
        (folder / "manifest.json").write_bytes(text.encode("latin-1"))
    assert any(line.startswith(told) for line in problems())


@pytest.mark.parametrize("name", ["manifest.json", "times.json"])
def test_files_that_never_end_are_not_read(folder, problems, name):
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name)
    assert problems()[:2][1] == "  it is no file"
    (folder / name).unlink()
    (folder / name).symlink_to("/dev/zero")
    lines = problems()
    assert "  it is no file" in lines and f"  {name} points to /dev/zero" in lines


def test_a_long_value_is_not_told_in_full(folder, problems):
    complete(folder, title=["x" * 10_000])
    assert max(map(len, problems())) < 200


def integers(path: Path) -> None:
    import OpenEXR

    whole = {name: np.ones((8, 8), np.uint32) for name in "RGBA"}
    OpenEXR.File({"type": OpenEXR.scanlineimage}, whole).write(str(path))


def stated(path: Path, primaries: tuple[float, ...]) -> None:
    import OpenEXR

    grey = {name: np.full((8, 8), 0.5, np.float32) for name in "RGBA"}
    OpenEXR.File({"type": OpenEXR.scanlineimage, "chromaticities": primaries}, grey).write(str(path))


def out_of_order(path: Path) -> None:
    """A kind of damage at which the library prints to standard output."""
    data = bytearray(path.read_bytes())
    data[data.index(b"lineOrder\0lineOrder\0") + 20] ^= 0xFF
    path.write_bytes(data)


def shifted(path: Path) -> None:
    import OpenEXR

    header = {"type": OpenEXR.scanlineimage, "dataWindow": ((2, 0), (9, 7)), "displayWindow": ((0, 0), (9, 7))}
    OpenEXR.File(header, {name: np.full((8, 8), 0.5, np.float32) for name in "RGBA"}).write(str(path))


def two_parts(path: Path) -> None:
    import OpenEXR

    grey = {name: np.full((8, 8), 0.5, np.float32) for name in "RGBA"}
    parts = [OpenEXR.Part({"type": OpenEXR.scanlineimage}, grey, name) for name in ("left", "right")]
    OpenEXR.File(parts).write(str(path))


def grey(path: Path, shape: tuple[int, int] = (8, 8), names: str = "RGBA", **values: float) -> None:
    write_exr(path, {name: np.full(shape, values.get(name, 0.5), np.float32) for name in names})


P3 = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329)
REC709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)


def test_alpha_a_rounding_beyond_its_range_is_clamped(protocol, folder, tmp_path):
    read = read_picture(draw(folder, KEY, np.full((8, 8, 3), 0.5), np.full((8, 8), 1.0000002)), frame_camera(protocol))
    assert (read.alpha == 1).all()
    assert not score(protocol, folder, tmp_path / "run").crashed


def test_a_depth_that_is_infinite_in_the_background_is_named_with_its_place(folder, problems):
    depth = np.ones((8, 8), np.float32)
    depth[3, 5:] = np.inf
    draw(folder, KEY, np.zeros((8, 8, 3)), np.zeros((8, 8)), **{"depth.Z": depth})
    told = "channel 'depth.Z' has 3 NaN or infinite pixels, the first (infinite) in row 3, column 5"
    assert f"  {KEY}.exr: {told}" in problems()


def test_a_manifest_may_begin_with_a_byte_order_mark(protocol, folder, tmp_path):
    path = folder / "manifest.json"
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert not score(protocol, folder, tmp_path / "run").crashed


def test_a_seed_that_no_result_could_keep_is_refused(folder, problems):
    complete(folder, seed=2**70)
    assert "does not fit into 64 bits" in problems()[1]


def frame_camera(protocol):
    frames = CAPTURES.load(protocol.capture)(size=protocol.size).frames()
    return next(frame.camera for frame in frames if frame.key == KEY)


@pytest.mark.parametrize(
    ("spoil", "kind", "told"),
    [
        (lambda path: path.unlink(), "missing", ""),
        (lambda path: path.write_bytes(path.read_bytes()[:-40]), "unreadable", " cannot be read ("),
        (lambda path: path.write_bytes(b""), "unreadable", " cannot be read ("),
        (lambda path: path.write_bytes(b"\x89PNG\r\n"), "unreadable", " cannot be read ("),
        (out_of_order, "unreadable", " cannot be read ("),
        (two_parts, "unreadable", " has 2 parts, expected 1"),
        (lambda path: grey(path, (16, 8)), "size", " is 8x16, its camera says 8x8"),
        (shifted, "size", " is 8x8 at (2, 0), its camera says 8x8"),
        (lambda path: grey(path, names="RGB"), "channels", " has B, G, R"),
        (lambda path: grey(path, names="RGBAZ"), "channels", " has A, B, G, R, Z"),
        (lambda path: grey(path, names="Y"), "channels", " has Y"),
        (integers, "channels", " has A as uint32"),
        (lambda path: stated(path, P3), "colour", " states the primaries P3-D65"),
        (lambda path: grey(path, A=1.5), "colour", " has alpha from 1.5 to 1.5"),
        (lambda path: grey(path, A=-0.5), "colour", " has alpha from -0.5 to -0.5"),
        (
            lambda path: grey(path, G=np.nan),
            "non-finite",
            ": channel 'G' has 64 NaN or infinite pixels, the first (NaN) in row 0, col",
        ),
        (
            lambda path: grey(path, G=np.inf),
            "non-finite",
            ": channel 'G' has 64 NaN or infinite pixels, the first (infinite) in row",
        ),
        (lambda path: grey(path, A=1.01), "colour", " has alpha from 1.01 to 1.01"),
        (lambda path: grey(path, A=np.nan), "non-finite", ": channel 'A' has 64 NaN or infinite pixels"),
        (lambda path: path.rename(path.with_suffix(".EXR")), "missing", ""),
    ],
)
def test_a_picture_that_does_not_fit(folder, problems, spoil, kind, told, capfd):
    path = folder / f"{KEY}.exr"
    spoil(path)
    lines = problems()
    out, err = capfd.readouterr()
    assert out == "" and "EXR" not in err, "the library may print nothing"
    (at,) = [i for i, line in enumerate(lines) if line.startswith(f"{kind} (1): ")]
    assert lines[at + 1].startswith(f"  {KEY}.exr{told}") and "Traceback" not in "".join(lines)


def test_what_a_picture_may_be(protocol, folder, tmp_path):
    """Half floats, the right primaries stated, and geometry along with it."""
    draw(folder, KEY, np.full((8, 8, 3), 0.25), np.ones((8, 8)), np.float16)
    stated(folder / "s01/pose-2/side/group-0.exr", REC709)
    maps = {"depth.Z": np.ones((8, 8), np.float32)} | {f"normal.{axis}": np.ones((8, 8), np.float16) for axis in "XYZ"}
    draw(folder, "s01/pose-2/front/env-park", np.full((8, 8, 3), 0.25), np.ones((8, 8)), **maps)
    (folder / "README.md").write_text("for people")
    (folder / ".DS_Store").write_text("for nobody")
    assert not score(protocol, folder, tmp_path / "run").crashed


def test_a_picture_too_large_to_hold_is_refused_by_its_header(folder, problems):
    """A few bytes that claim 100,000 x 100,000 pixels."""
    path = folder / f"{KEY}.exr"
    data = bytearray(path.read_bytes())
    for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        at = data.index(name) + len(name) + 4
        data[at : at + 16] = np.array([0, 0, 99_999, 99_999], "<i4").tobytes()
    path.write_bytes(data)
    lines = problems()
    assert lines[0].startswith(("size (1)", "unreadable (1)")) and KEY in lines[1]


def test_names_that_mean_nothing(folder, problems):
    (folder / "s01/pose-2/front/group-0.png").write_bytes(b"")
    (folder / "S01/pose-2/front").mkdir(parents=True)
    shutil.copy(folder / f"{KEY}.exr", folder / "S01/pose-2/front/group-0.exr")
    (folder / "s01/pose-2/side/env-park.exr").rename(folder / "s01/pose-2/side/Env-Park.exr")
    lines = problems()
    assert "unexpected (2): these answer no query; remove them, or mend their names" in lines
    assert any(line.startswith("  s01/pose-2/front/group-0.png (where manifest.json says") for line in lines)
    assert "  s01/pose-2/side/Env-Park.exr (did you mean s01/pose-2/side/env-park.exr?)" in lines
    assert "  S01/pose-2/front/group-0.exr beside s01/pose-2/front/group-0.exr" in lines
    assert "missing (1): no picture for these queries; draw them, or score what is there with --allow-missing" in lines


def test_links_that_leave_the_folder_are_not_followed(folder, problems, tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    path = folder / f"{KEY}.exr"
    shutil.move(path, outside / "secret.exr")
    os.mkfifo(outside / "pipe")  # reading it would hang
    path.symlink_to(outside / "secret.exr")
    (folder / "s01/pose-2/side/group-0.exr").unlink()
    (folder / "s01/pose-2/side/group-0.exr").symlink_to(outside / "pipe")
    shutil.move(folder / "s02", outside / "s02")
    (folder / "s02").symlink_to(outside / "s02")
    loop = folder / "s01/pose-2/front/env-park.exr"
    loop.unlink()
    loop.symlink_to(loop)
    lines = problems()
    assert lines[0].startswith("missing ") or lines[0].startswith("link")
    at = next(i for i, line in enumerate(lines) if line.startswith("link (4): "))
    assert (
        f"  {KEY}.exr points to {outside / 'secret.exr'}" in lines[at:]
        and f"  s02 points to {outside / 's02'}" in lines
    )


def test_links_within_the_folder_are_fine_and_pipes_are_no_pictures(protocol, folder, problems, tmp_path):
    path = folder / f"{KEY}.exr"
    twin = folder / "s01/pose-2/side/group-0.exr"
    twin.unlink()
    twin.symlink_to(path)
    assert not score(protocol, folder, tmp_path / "first").crashed
    path.unlink()
    os.mkfifo(path)
    assert f"  {KEY}.exr cannot be read (is no regular file; check its path)" in problems()


def test_a_query_cannot_lead_out_of_the_folder(protocol, folder):
    capture = CAPTURES.load("toy")(size="tiny")
    evil = replace(capture.frames()[0], subject="..")
    asked = Asked.of(protocol.label, protocol.digest, capture.digest, [evil.query])
    with pytest.raises(InputError, match="would lead out of"):
        read_folder(folder, asked)


def as_png(folder: Path) -> None:
    """The folder's pictures as sRGB with straight alpha."""
    frames = CAPTURES.load("toy")(size="tiny").frames()
    for path in [path for path in folder.rglob("*.exr") if "asked" not in path.parts]:
        seen = read_picture(path, next(frame.camera for frame in frames if frame.key in str(path)))
        alpha = seen.alpha[..., None]
        straight = np.divide(seen.image, alpha, out=np.zeros_like(seen.image), where=alpha > 0)
        shown = np.concatenate([srgb(straight), alpha], axis=-1)
        Image.fromarray(np.round(255 * shown).astype(np.uint8)).save(path.with_suffix(".png"))
        path.unlink()


def test_png_pictures_are_scored_where_the_manifest_says_what_they_are(protocol, folder, problems, tmp_path):
    linear = rows(score(protocol, folder, tmp_path / "linear").folder)["theirs"]
    as_png(folder)
    told = f"  {KEY}.png (where manifest.json says that colour is 'sRGB, straight alpha' it is read)"
    assert told in problems()
    complete(folder, colour="sRGB, straight alpha")
    shown = rows(score(protocol, folder, tmp_path / "shown").folder)["theirs"]
    for one, other in zip(linear, shown, strict=True):
        assert one["query"] == other["query"] and other["value"] == pytest.approx(one["value"], rel=0.02)
    Image.new("RGB", (4, 4)).save(folder / f"{KEY}.png")
    (folder / "s01/pose-2/side/group-0.png").write_bytes(b"no picture")
    with pytest.raises(Unfit) as found:
        score(protocol, folder, tmp_path / "bad")
    heads = [line.split(" ", 1)[0] for line in found.value.lines if not line.startswith(" ")]
    assert heads == ["unreadable", "size"]


def test_all_problems_are_told_at_once_and_long_lists_are_cut(folder, problems):
    for i in range(25):
        (folder / f"extra-{i:02d}.txt").write_text("")
    grey(folder / f"{KEY}.exr", (4, 4))
    (folder / "s01/pose-2/front/env-park.exr").unlink()
    complete(folder, colour="sRGB")
    lines = problems()
    heads = [line.split(" ", 1)[0] for line in lines if not line.startswith(" ")]
    assert heads == ["manifest", "missing", "unexpected", "size"]
    assert "  extra-19.txt" in lines and "  extra-20.txt" not in lines and "  … and 5 more" in lines


def test_allow_missing_scores_what_is_there(protocol, folder, tmp_path):
    (folder / f"{KEY}.exr").unlink()
    grey(folder / "s01/pose-2/side/group-0.exr", G=np.nan)
    outcome = score(protocol, folder, tmp_path / "run", allow_missing=True)
    reasons = {each["query"]: each["reason"] for each in rows(outcome.folder)["theirs"]}
    assert reasons.pop(KEY) == "unsupported: the prediction folder has no picture of this query"
    assert reasons.pop("s01/pose-2/side/group-0") == "non-finite: 64 values of the prediction are NaN or infinite"
    assert set(reasons.values()) == {None} and not outcome.crashed


def test_allow_missing_allows_no_other_mistake(folder, problems):
    grey(folder / f"{KEY}.exr", (4, 4))
    assert problems(allow_missing=True)[0].startswith("size (1)")


def test_not_one_picture_is_no_answer(folder, problems):
    for path in folder.rglob("*.exr"):
        if "asked" not in path.parts:
            path.unlink()
    assert problems(allow_missing=True) == [
        "missing (1): no picture for these queries; draw them, or score what is there with --allow-missing",
        "  there is not one picture",
    ]


def test_times_are_what_their_authors_say(protocol, folder, tmp_path):
    told = {"device": "a fast GPU", "what": "one warm frame", "milliseconds": {KEY: 3, "s01/pose-2/side/group-0": 5.5}}
    (folder / "times.json").write_text(json.dumps(told))
    outcome = score(protocol, folder, tmp_path / "run")
    (method,) = [m for m in json.loads((outcome.folder / "run.json").read_text())["methods"] if m["name"] == "theirs"]
    assert method["fidelity"].endswith("not run here; its authors tell 4.25 ms a frame on a fast GPU")
    assert method["config"]["times told by its authors"]["count"] == 2


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"milliseconds": {"s09/x/y/z": 1.0}}, "  s09/x/y/z is no query of the protocol"),
        ({"milliseconds": {KEY: -1}}, f"  {KEY} took -1; give milliseconds above 0"),
        ({"milliseconds": {KEY: float("nan")}}, f"  {KEY} took nan; give milliseconds above 0"),
        ({"milliseconds": {KEY: "3 ms"}}, f"  {KEY} took '3 ms'; give milliseconds above 0"),
        ({"milliseconds": []}, "  milliseconds is []; give an object of query to milliseconds"),
        ({"device": ""}, "  device is ''; give a text"),
        ({"gpu": "fast"}, "  'gpu' is not known; the keys are device, what, milliseconds"),
    ],
)
def test_times_that_do_not_fit(folder, problems, change, told):
    content = {"device": "a fast GPU", "what": "one warm frame", "milliseconds": {KEY: 3.0}, **change}
    (folder / "times.json").write_text(json.dumps(content))
    lines = problems()
    assert lines[0].startswith("times (1)") and told in lines


def test_a_name_that_is_taken_or_unfit(protocol, folder, tmp_path):
    with pytest.raises(InputError, match="there is a method 'urhand' already; choose another name"):
        score(protocol, folder, tmp_path / "run", name="urhand")
    with pytest.raises(InputError, match=r"name '\.\./up' cannot be a method's"):
        score(protocol, folder, tmp_path / "run", name="../up")
    assert not (tmp_path / "run").exists()


def test_the_command_line(fakes, toy_table, folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    table = toy_table(methods=["oracle", "toy"])
    monkeypatch.setattr("handbench.bench.run.find_protocol", lambda name: handbench.protocols.parse(table, name))
    assert main(["score", "toy", str(folder), "--name", "theirs-2"]) == 0
    out, _ = capsys.readouterr()
    assert "Theirs" in out and "Oracle" in out and "runs/toy-theirs-2" in out
    page = next(line.removeprefix("report: ") for line in out.splitlines() if line.startswith("report: "))
    assert "predictions from a folder, not run here" in Path(page).read_text()
    grey(folder / f"{KEY}.exr", (4, 4))
    assert main(["score", "toy", str(folder), "--out", "second"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and not (tmp_path / "second").exists()
    progress, head, text, last = err.splitlines()
    assert progress.startswith("capture toy") and head.startswith("size (1): ") and KEY in text
    assert last == f"handbench: prediction folder {folder} cannot be scored (size 1); nothing was written"
    assert main(["score", "toy", "nowhere"]) == 2
    assert "there is no prediction folder nowhere; check its path" in capsys.readouterr().err
    assert main(["score", "toy", "--template", "new"]) == 0
    said = capsys.readouterr().out
    assert "10 pictures are asked for, see new/asked/queries.json" in said
    assert "method: up to 64 letters, digits, points, dashes and underscores" in said
    assert main(["score", "toy", "--template", "newer", "--name", "theirs"]) == 2
    assert (
        capsys.readouterr().err
        == "handbench: --name goes with a prediction folder, not with --template; leave it out\n"
    )
    assert main(["score", "toy", str(folder), "--images"]) == 2
    assert capsys.readouterr().err == "handbench: --images goes with --template; leave it out\n"
    for bad in (["score", "toy"], ["score", "toy", "folder", "--template", "new"]):
        with pytest.raises(SystemExit) as stop:
            main(bad)
        assert stop.value.code == 2
