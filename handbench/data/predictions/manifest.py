"""manifest.json and times.json of a prediction folder."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from statistics import median
from typing import Any

from ...errors import InputError
from ...files import check_value
from .problems import Problems

FORMAT, VERSION = "handbench predictions", 1
COLOUR = "linear Rec. 709, premultiplied over black"
DISPLAYED = "sRGB, straight alpha"
SUFFIXES = {COLOUR: ".exr", DISPLAYED: ".png"}
"""Of pictures, by what the manifest says of their colour."""
MANIFEST, TIMES = "manifest.json", "times.json"
METHOD_NAME = "up to 64 letters, digits, points, dashes and underscores"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_BYTES = 64 << 20  # no honest file is larger


@dataclass(frozen=True)
class PredictionManifest:
    """Which questions the pictures answer and who drew them.

    protocol            name@version
    protocol_digest     `Protocol.digest`: what decides a score
    capture_digest      `Capture.digest`
    method, title       a short name for files, and what tables call it
    seed                of the training, for the report
    note                what a reader should know, one line
    colour              what the values of the pictures are, a key of `SUFFIXES`
    """

    protocol: str
    protocol_digest: str
    capture_digest: str
    method: str = ""
    title: str = ""
    seed: int = 0
    note: str = ""
    colour: str = COLOUR

    @property
    def suffix(self) -> str:
        return SUFFIXES[self.colour]

    def content(self) -> dict[str, Any]:
        """As it stands in the file."""
        return {"format": FORMAT, "version": VERSION, "colour": self.colour, **asdict(self)}


@dataclass(frozen=True)
class DeclaredTimes:
    """What the authors say: on which device, what was timed, and the median over `count` queries in milliseconds."""

    device: str
    what: str
    median_ms: float
    count: int


def name_fits(name: str) -> bool:
    """Whether a method's name can be part of a file name."""
    return _NAME.fullmatch(name) is not None


def read_manifest(folder: Path, wanted: PredictionManifest, problems: Problems) -> PredictionManifest | None:
    """The manifest, which must answer what `wanted` asks; all that is wrong goes to `problems`, and then None."""

    def wrong(text: str) -> None:
        problems.add("manifest", text)

    content = _object(folder / MANIFEST, wrong)
    if content is None:
        return None
    before = problems.counts()
    if content.get("format") != FORMAT:
        wrong(f'format is {_shown(content.get("format"))}, expected "{FORMAT}"')
    elif content.get("version") != VERSION:
        wrong(f"version is {_shown(content.get('version'))}, this handbench reads {VERSION}")
    if content.get("colour") not in list(SUFFIXES):  # it may be of any type
        wrong(f'colour is {_shown(content.get("colour"))}, expected "{COLOUR}" (EXR) or "{DISPLAYED}" (PNG)')
    _same("protocol", content, wanted.protocol, wrong)
    _same("capture_digest", content, wanted.capture_digest, wrong)
    if content.get("protocol") == wanted.protocol:  # another protocol has another digest anyway
        _same("protocol_digest", content, wanted.protocol_digest, wrong)
    known = wanted.content()
    for key in sorted(content.keys() - known.keys()):
        wrong(f"{_shown(key)} is not known; the keys are {', '.join(known)}")
    for key in ("method", "title"):
        text = content.get(key)
        if not isinstance(text, str) or not text.strip():
            wrong(f"{key} is {_shown(text)}; give a text")
    method = content.get("method")
    if isinstance(method, str) and method.strip() and not name_fits(method):
        wrong(f"method is {_shown(method)}; use {METHOD_NAME}")
    if type(content.get("seed", 0)) is not int or content.get("seed", 0) < 0:
        wrong(f"seed is {_shown(content['seed'])}; give a whole number, at least 0")
    if not isinstance(content.get("note", ""), str):
        wrong(f"note is {_shown(content['note'])}; give a text")
    if problems.counts() != before:
        return None
    return PredictionManifest(
        **{field.name: content[field.name] for field in fields(PredictionManifest) if field.name in content}
    )


def read_times(folder: Path, queries: Collection[str], problems: Problems) -> DeclaredTimes | None:
    """What times.json says, or None where there is none; all that is wrong with it goes to `problems`."""

    def wrong(text: str) -> None:
        problems.add("times", text)

    path = folder / TIMES
    content = _object(path, wrong) if path.exists() else None
    if content is None:
        return None
    for key in sorted(content.keys() - {"device", "what", "milliseconds"}):
        wrong(f"{_shown(key)} is not known; the keys are device, what, milliseconds")
    told = content.get("milliseconds")
    for key in ("device", "what"):
        if not isinstance(content.get(key), str) or not content[key].strip():
            wrong(f"{key} is {_shown(content.get(key))}; give a text")
    if not isinstance(told, dict) or not told:
        wrong(f"milliseconds is {_shown(told)}; give an object of query to milliseconds")
        return None
    for query, value in told.items():
        if query not in queries:
            wrong(f"{_shown(query)[1:-1]} is no query of the protocol")
        elif type(value) not in (int, float) or not math.isfinite(value) or value <= 0:
            wrong(f"{query} took {_shown(value)}; give milliseconds above 0")
    if problems.counts().get("times"):
        return None
    return DeclaredTimes(content["device"], content["what"], float(median(told.values())), len(told))


def _same(key: str, content: Mapping[str, Any], wanted: str, wrong: Callable[[str], None]) -> None:
    if content.get(key) != wanted:
        wrong(f"{key} is {_shown(content.get(key))}, expected {wanted!r}")


def _shown(value: Any) -> str:
    """A value of the file for people, not all of it if it is long."""
    text = repr(value)
    return text if len(text) <= 100 else f"{text[:97]}…"


def _object(path: Path, wrong: Callable[[str], None]) -> dict[str, Any] | None:
    """The JSON object in a file; None, and why, if there is none."""

    def distinct(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key, value in pairs:
            if key in found:
                wrong(f"{_shown(key)} is given twice")
            found[key] = value
        return found

    if path.exists() and not path.is_file():  # reading a pipe would never end
        wrong("it is no file")
        return None
    try:
        if path.stat().st_size > _BYTES:
            wrong(f"it has more than {_BYTES >> 20} MB")
            return None
        content = json.loads(path.read_text(encoding="utf-8-sig"), object_pairs_hook=distinct)  # with or without a BOM
        check_value(content, "it cannot be kept")
    except InputError as error:
        wrong(str(error))
        return None
    except OSError as error:
        wrong(f"it cannot be read ({error.strerror})")
        return None
    except (ValueError, RecursionError) as error:
        wrong(f"it is no JSON ({error})")
        return None
    if not isinstance(content, dict):
        wrong("it holds no JSON object")
        return None
    return content
