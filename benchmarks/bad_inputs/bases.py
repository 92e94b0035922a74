"""Sound inputs, made once in a folder: what the bad ones are made from, and what the right answers are."""

from __future__ import annotations

import contextlib
import io
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from handbench.cli import main
from handbench.data.exr import rgb, write_exr

from .sound import Hands, make_hands
from .worker import VALUES, capture, environment, protocol

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Bases:
    """Sound inputs.

    protocol        text of a protocol file: two columns of two frames, PSNR
    run             the folder of its run, with `values` by method, seed, query and metric
    predictions     a folder that a method drew elsewhere, whose values are `drawn`
    capture         the folder of the smallest light stage
    pictures        files by name: pairs of `prediction.*` and `truth.*` whose PSNR is `psnr`
    maps            environment maps by name, all of one mean radiance
    hands           what is about hands
    """

    protocol: str
    run: Path
    values: dict[str, float]
    predictions: Path
    drawn: dict[str, float]
    capture: Path
    pictures: dict[str, bytes]
    psnr: float
    maps: dict[str, bytes]
    answers: dict[str, str]
    hands: Hands


def make_bases(folder: Path) -> Bases:
    """All of it, in some thirty seconds."""
    text = _protocol()
    (folder / "p.toml").write_text(text)
    _handbench(folder, "run", "p.toml", "--methods", "oracle,mean", "--out", "run")
    _handbench(folder, "score", "p.toml", "--template", "drawn")
    for picture in sorted((folder / "run" / "predictions").glob("*/*.exr")):
        place = folder / "drawn" / (picture.name.replace("__", "/"))
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(picture.read_bytes())
    manifest = json.loads((folder / "drawn" / "manifest.json").read_text())
    (folder / "drawn" / "manifest.json").write_text(json.dumps({**manifest, "method": "mine", "title": "Mine"}))
    _handbench(folder, "score", "p.toml", "drawn", "--out", "scored")
    stage = ROOT / "handbench" / "data" / "openstage" / "mini"
    maps = _maps(folder)
    pictures, psnr = _pictures(folder)
    told = {"protocol": protocol(folder / "p.toml"), "environment": environment(folder / "m.hdr")}
    return Bases(
        text,
        folder / "run",
        values(_handbench(folder, "query", "run", VALUES, "--format", "json")),
        folder / "drawn",
        values(_handbench(folder, "query", "scored", VALUES, "--format", "json")),
        stage,
        pictures,
        psnr,
        maps,
        {**told, "capture": capture(stage)},
        make_hands(folder),
    )


def values(told: str) -> dict[str, float]:
    """Values that are there, by all that names them, from what a query printed."""
    rows = json.loads(told)
    return {
        "|".join(str(row[name]) for name in ("method", "seed", "query", "metric")): row["value"]
        for row in rows
        if row["value"] is not None
    }


def _protocol() -> str:
    text = (ROOT / "protocols" / "smoke.toml").read_text()
    head, *columns = text.split("[[column]]")
    head = head.replace('metrics = ["psnr", "ssim"]', 'metrics = ["psnr"]')
    published = '\n[[published]]\nmethod = "urhand"\ntitle = "URHand"\nsource = "Table 1"\n'
    published += 'values = { "unseen-segment" = { psnr = 30.5 }, "unseen-subject" = { psnr = 29 } }\n'
    return "[[column]]".join([head, *columns[:2]]) + published


def _handbench(folder: Path, *words: str) -> str:
    """What handbench prints if it is started in a folder."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(list(words))
    if code:
        raise RuntimeError(f"the sound input fails: handbench {' '.join(words)}: {err.getvalue()}")
    return out.getvalue()


def _pictures(folder: Path) -> tuple[dict[str, bytes], float]:
    """Two pictures whose values 8 bits hold, in every format; and their PSNR by its definition."""
    rng = np.random.default_rng(0)
    codes = rng.integers(40, 200, (2, 24, 32, 3)).astype(np.uint8)
    codes[1] = codes[0] + rng.integers(-9, 10, codes[0].shape)
    shown = codes / 255.0
    linear = np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4).astype(np.float32)
    found = {}
    for name, code, image in zip(("prediction", "truth"), codes, linear, strict=True):
        png = io.BytesIO()
        Image.fromarray(code).save(png, "PNG")
        array = io.BytesIO()
        np.save(array, image)
        write_exr(folder / f"{name}.exr", {**rgb(image), "A": np.ones(image.shape[:2], np.float32)})
        found[f"{name}.png"], found[f"{name}.npy"] = png.getvalue(), array.getvalue()
        found[f"{name}.exr"] = (folder / f"{name}.exr").read_bytes()
    return found, float(-10 * np.log10(np.mean((shown[0] - shown[1]) ** 2)))


def _maps(folder: Path) -> dict[str, bytes]:
    """A map as Radiance picture (flat, no run lengths) and as EXR."""
    exponents = np.full((8, 16, 1), 129, np.uint8)
    mantissas = np.random.default_rng(1).integers(128, 256, (8, 16, 3)).astype(np.uint8)
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n"
    (folder / "m.hdr").write_bytes(head + np.concatenate([mantissas, exponents], -1).tobytes())
    radiance = ((mantissas.astype(np.float32)) * 2.0 ** (129 - 136)).astype(np.float32)
    write_exr(folder / "m.exr", rgb(radiance))
    return {name: (folder / name).read_bytes() for name in ("m.hdr", "m.exr")}
