"""handbench metrics compare: one prediction under many metrics, from files, in three formats."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from handbench.cli import main
from handbench.data.exr import write_exr
from handbench.metrics import ENTRIES, Pair, metric

GEOMETRY = [entry.name for entry in ENTRIES if ".geometry." in entry.target and entry.name != "mask-iou"]


def scene(shift: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A prediction, a truth (both premultiplied, linear) and alpha, (48, 40, …) float32."""
    y, x = np.mgrid[0:48, 0:40]
    alpha = (np.hypot(y - 24, x - 18) < 14).astype(np.float32)
    truth = (0.4 + 0.3 * np.stack([np.sin(x / 4), np.cos(y / 5), np.sin((x + y) / 6)], -1)) * alpha[..., None]
    wrong = 0.05 * np.cos(x * y / 9.0 + shift)[..., None] * alpha[..., None]
    return (0.85 * truth + wrong).clip(0).astype(np.float32), truth.astype(np.float32), alpha


def write(path: Path, image: np.ndarray, alpha: np.ndarray | None = None) -> Path:
    channels = {name: np.ascontiguousarray(image[..., i]) for i, name in enumerate("RGB")}
    write_exr(path, channels | ({} if alpha is None else {"A": alpha}))
    return path


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    prediction, truth, alpha = scene()
    return write(tmp_path / "p.exr", prediction, alpha), write(tmp_path / "t.exr", truth, alpha)


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    for name in ("pred", "true"):
        (tmp_path / name).mkdir()
    for i in range(3):
        prediction, truth, alpha = scene(float(i))
        write(tmp_path / "pred" / f"f{i}.exr", prediction, alpha)
        write(tmp_path / "true" / f"f{i}.exr", truth, alpha)
    return tmp_path / "pred", tmp_path / "true"


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_json_holds_the_values_of_every_file_and_their_means(folders, files, capsys) -> None:
    assert main(["metrics", "compare", *map(str, folders), "--metrics", "psnr", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    values = told["values"]["psnr"]
    assert len(values) == 3 and told["means"]["psnr"] == pytest.approx(np.mean(list(values.values())))
    assert main(["metrics", "compare", *map(str, files), "--metrics", "psnr", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["values"]["psnr"]) == 1


def test_the_terminal_shows_every_metric_that_pictures_allow(files, capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    assert main(["metrics", "compare", *map(str, files)]) == 0
    out = capsys.readouterr().out
    pair = Pair(*scene(), prediction_alpha=scene()[2])
    for name, text in (("psnr", r"\d+\.\d\d  dB"), ("goliath-psnr", r"\d+\.\d\d  dB"), ("uhm-iou", r"100\.00  %")):
        assert re.search(rf"^  {name} +{text}", out, re.M), name
        assert metric(name).signature in out.splitlines()
    expected = metric("palm-official-ssim")([pair])[0].value
    assert re.search(rf"^  palm-official-ssim +{expected:.4f}", out, re.M)
    assert out.index("PSNR ↑") < out.index("stanford-orb-psnr-ldr") < out.index("LPIPS ↓")
    assert re.search(r"no value \([^)]*160 pixels[^)]*\): .*harp-ms-ssim", out.replace("\n", " "))
    for name in GEOMETRY:
        assert not re.search(rf"^  {name} ", out, re.M)
    assert f"the mask covers {100 * scene()[2].mean():.1f} % of the picture" in out


def test_csv_has_each_file_and_the_mean_in_full_precision(folders, capsys) -> None:
    assert main(["metrics", "compare", *map(str, folders), "--format", "csv", "--only", "goliath-psnr"]) == 0
    found = rows(capsys.readouterr().out)
    expected = [metric("goliath-psnr")([Pair(*scene(float(i)))])[0].value for i in range(3)]
    assert [row["file"] for row in found] == ["f0", "f1", "f2", ""]
    assert [float(row["value"]) for row in found] == pytest.approx([*expected, np.mean(expected)], rel=1e-12)
    assert found[0]["signature"] == metric("goliath-psnr").signature and found[-1]["scored"] == "3/3"


def test_aligned_scores_stand_beside_raw_ones(files, capsys) -> None:
    assert main(["metrics", "compare", *map(str, files), "--format", "csv", "--only", "psnr"]) == 0
    raw, aligned = rows(capsys.readouterr().out)
    assert (raw["metric"], aligned["metric"]) == ("psnr", "psnr:scale=rgb")
    assert float(aligned["value"]) > float(raw["value"]) + 1


def test_markdown_is_one_table_and_the_remarks(tmp_path, capsys) -> None:
    prediction, truth, _ = scene()
    given = [str(write(tmp_path / "p.exr", prediction)), str(write(tmp_path / "t.exr", truth))]
    assert main(["metrics", "compare", *given, "--format", "markdown", "--only", "*psnr*"]) == 0
    out = capsys.readouterr().out
    assert "| goliath-psnr | ↑ |" in out and r"goliath-psnr\|clip:truth\|" in out
    assert "the whole picture counts as the hand" in out and "the truth's is taken" in out
    assert main(["metrics", "compare", *given, "--format", "csv", "--only", "psnr"]) == 0
    out, err = capsys.readouterr()
    assert "counts as the hand" in err and "counts as the hand" not in out


def test_a_sequence_adds_flicker_and_only_if_asked(folders, capsys) -> None:
    arguments = ["metrics", "compare", *map(str, folders), "--format", "csv", "--only", "psnr"]
    assert main([*arguments, "--sequence"]) == 0
    (row,) = [row for row in rows(capsys.readouterr().out) if row["metric"] == "flicker"]
    assert float(row["value"]) > 0.01 and row["better"] == "lower"
    assert main(arguments) == 0
    assert "flicker" not in capsys.readouterr().out


def test_a_mask_makes_a_photograph_what_alpha_would(tmp_path, capsys) -> None:
    prediction, truth, alpha = scene()
    photograph = truth + np.float32(0.3) * (1 - alpha[..., None])
    Image.fromarray((alpha * 255).astype(np.uint8)).save(tmp_path / "m.png")
    given = {"a": write(tmp_path / "a.exr", truth, alpha), "p": write(tmp_path / "p.exr", prediction)}
    given["b"] = write(tmp_path / "b.exr", photograph)
    values = []
    for extra in ([str(given["a"])], [str(given["b"]), "--mask", str(tmp_path / "m.png")]):
        assert main(["metrics", "compare", str(given["p"]), *extra, "--format", "csv", "--only", "*ssim"]) == 0
        values.append([row["value"] for row in rows(capsys.readouterr().out)])
    assert values[0] == values[1] and len(values[0]) > 4


def test_the_encoding_can_be_said(tmp_path, capsys) -> None:
    np.save(tmp_path / "p.npy", np.full((40, 40, 3), 188, np.uint8))
    np.save(tmp_path / "t.npy", np.full((40, 40, 3), 0.5029, np.float32))
    given = [
        "metrics",
        "compare",
        str(tmp_path / "p.npy"),
        str(tmp_path / "t.npy"),
        "--format",
        "csv",
        "--only",
        "psnr",
    ]
    assert main([*given, "--pred-encoding", "srgb"]) == 0
    assert float(rows(capsys.readouterr().out)[0]["value"]) > 60
    assert main([*given, "--pred-encoding", "linear"]) == 0
    assert float(rows(capsys.readouterr().out)[0]["value"]) < 20
    assert main(given) == 2
    assert "whose encoding is unknown" in capsys.readouterr().err


def test_links_are_followed(files, tmp_path, capsys) -> None:
    (tmp_path / "link.exr").symlink_to(files[0])
    assert main(["metrics", "compare", str(tmp_path / "link.exr"), str(files[1]), "--only", "psnr"]) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["absent.exr", "t.exr"], "prediction absent.exr does not exist"),
        (["p.exr", "true"], "prediction p.exr is a file, but a folder was given too"),
        (["p.exr", "small.exr"], "p.exr is 40x48 pixels and small.exr is 40x30"),
        (["p.exr", "t.exr", "--mask", "small.exr"], "small.exr is 40x30 pixels and t.exr is 40x48"),
        (["p.exr", "t.exr", "--only", "pnsr"], "unknown metric 'pnsr'; did you mean 'psnr'"),
        (["pred", "true"], "truth folder true lacks f0, f2; pictures of equal names are compared"),
        (["nan.npy", "t.exr"], "nan.npy holds 5760 values that are NaN, infinite or beyond 32-bit floats"),
        (["empty", "true"], "folder empty holds no pictures"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    arguments, message, files, folders, tmp_path, monkeypatch, capsys
) -> None:
    write(tmp_path / "small.exr", scene()[1][:30], scene()[2][:30])
    np.save(tmp_path / "nan.npy", np.full((48, 40, 3), np.nan))
    (tmp_path / "empty").mkdir()
    for name in ("f0", "f2"):
        (tmp_path / "true" / f"{name}.exr").unlink()
    monkeypatch.chdir(tmp_path)
    assert main(["metrics", "compare", *arguments]) == 2
    out, err = capsys.readouterr()
    assert message in err and err.count("\n") == 1 and out == ""


def values(capsys, *arguments: str) -> dict[str, str]:
    """The values by metric, from the command's CSV."""
    assert main(["metrics", "compare", *map(str, arguments), "--format", "csv"]) == 0
    return {row["metric"]: row["value"] for row in rows(capsys.readouterr().out)}


def test_one_picture_with_nan_or_damage_loses_only_itself(folders, capsys) -> None:
    prediction, _, alpha = scene(1.0)
    prediction[20, 20] = np.nan
    write(folders[0] / "f1.exr", prediction, alpha)
    (folders[0] / "f2.exr").write_bytes(b"cut off")
    assert main(["metrics", "compare", *map(str, folders), "--format", "csv", "--only", "goliath-psnr"]) == 0
    found = rows(capsys.readouterr().out)
    assert found[0]["value"] == found[3]["value"] != "" and found[3]["scored"] == "1/3"
    assert "f1.exr: channel 'R' has 1 NaN" in found[1]["reason"] and "f2.exr is damaged" in found[2]["reason"]
    assert main(["metrics", "compare", *map(str, folders), "--format", "csv", "--only", "psnr", "--sequence"]) == 0
    (row,) = [row for row in rows(capsys.readouterr().out) if row["metric"] == "flicker"]
    assert row["reason"].startswith("the sequence has gaps: ")
    (folders[0] / "f0.exr").write_bytes(b"cut off")
    assert main(["metrics", "compare", *map(str, folders), "--only", "psnr"]) == 2
    assert "f0.exr is damaged" in capsys.readouterr().err


def test_two_photographs_under_a_mask_score_as_their_hands_on_black(tmp_path, capsys) -> None:
    prediction, truth, alpha = scene()
    white = 1 - alpha[..., None]
    Image.fromarray((alpha * 255).astype(np.uint8)).save(tmp_path / "m.png")
    on_black = [write(tmp_path / "p.exr", prediction), write(tmp_path / "t.exr", truth, alpha)]
    on_white = [write(tmp_path / "pw.exr", prediction + white), write(tmp_path / "tw.exr", truth + white)]
    mask = ["--mask", tmp_path / "m.png"]
    expected = values(capsys, *on_black, "--only", "[sl]*[sm]*")
    assert {"ssim", "lpips-alex"} <= expected.keys()
    for pair in (on_white, [on_white[0], on_black[1]], [on_black[0], on_white[1]]):
        assert values(capsys, *pair, *mask, "--only", "[sl]*[sm]*") == expected
    main(["metrics", "compare", *map(str, on_white), *map(str, mask), "--only", "psnr"])
    assert "not black outside the mask" in capsys.readouterr().out
    main(["metrics", "compare", str(on_white[0]), str(on_black[1]), "--only", "psnr"])
    assert "has no alpha and is not black outside the truth's" in capsys.readouterr().out


def test_straight_alpha_layers_and_parts_can_be_said(tmp_path, capsys) -> None:
    import OpenEXR

    _, truth, alpha = scene()
    alpha = np.where(alpha > 0, np.float32(0.8), np.float32(0))
    premultiplied = write(tmp_path / "t.exr", truth * 0.8, alpha)
    straight = write(tmp_path / "s.exr", truth + 0.3 * (alpha == 0)[..., None].astype(np.float32), alpha)
    assert values(capsys, straight, premultiplied, "--pred-alpha", "straight", "--only", "psnr")["psnr"] == "100.0"
    main(["metrics", "compare", str(straight), str(premultiplied), "--only", "psnr"])
    assert "the prediction has colour where its alpha is 0" in capsys.readouterr().out
    layer = {f"View.Combined.{name}": np.ascontiguousarray(truth[..., i]) for i, name in enumerate("RGB")}
    write_exr(tmp_path / "layer.exr", layer)
    parts = [OpenEXR.Part({}, {n: np.full((48, 40), v, np.float32) for n in "RGB"}, p) for p, v in (("l", 0), ("r", 1))]
    OpenEXR.File(parts).write(str(tmp_path / "parts.exr"))
    for name, option, value in (("layer", "layer", "View.Combined"), ("parts", "part", "r"), ("parts", "part", "1")):
        file = str(tmp_path / f"{name}.exr")
        assert main(["metrics", "compare", file, file, "--only", "psnr"]) == 2
        assert f"say which one counts (--{option})" in capsys.readouterr().err
        assert values(capsys, file, file, f"--{option}", value, "--only", "psnr")["psnr"] == "100.0"
    assert main(["metrics", "compare", file, file, "--part", "middle", "--only", "psnr"]) == 2
    assert "has no part 'middle'; it has 'l' and 'r'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda image: image * 2 - 1, "the truth has negative values (least -1): values of -1 to 1"),
        (lambda image: image * 255, "the truth's median (of what is not black in the mask) is 1"),
    ],
)
def test_values_that_are_hardly_linear_light_get_a_remark(tmp_path, capsys, change, told) -> None:
    prediction, truth, _ = scene()
    np.save(tmp_path / "t.npy", change(truth))
    main(["metrics", "compare", str(write(tmp_path / "p.exr", prediction)), str(tmp_path / "t.npy"), "--only", "psnr"])
    assert told in capsys.readouterr().out


def test_a_limit_is_looked_at_before_memory_is_taken(files, capsys) -> None:
    assert main(["metrics", "compare", *map(str, files), "--max-pixels", "1919"]) == 2
    assert "p.exr is 40x48, more than 1919 pixels; make it smaller" in capsys.readouterr().err
    assert main(["metrics", "compare", *map(str, files), "--max-pixels", "1920", "--only", "psnr"]) == 0
