"""The table of families: each makes a bad input from a seeded generator and the sound inputs."""

from __future__ import annotations

import json
import math
import random
from collections.abc import Callable
from pathlib import Path

from handbench.results.recordfile import sealed

from .bases import Bases, values
from .case import BadInput
from .hands import ENDLESS, avatars, formats, layouts, verbs
from .mutate import HOSTILE_TEXTS, spoiled_bytes, spoiled_json, spoiled_toml
from .surroundings import surroundings
from .worker import VALUES

Family = Callable[[random.Random, Bases], BadInput]


def protocols(rng: random.Random, bases: Bases) -> BadInput:
    """A protocol file, spoiled; or written in another way, which changes nothing."""
    if rng.random() < 0.1:
        return _special(rng, "protocols", "p.toml", ("call:protocol", "p.toml"))
    if rng.random() < 0.15:
        name, change = rng.choice(_SAME)
        text, right = change(bases.protocol), _says(bases.answers["protocol"])
    else:
        name, text, right = "spoiled", spoiled_toml(rng, bases.protocol), None
    words = (
        ("call:protocol", "p.toml") if rng.random() < 0.8 else ("run", "p.toml", "--methods", "absent", "--out", "o")
    )
    if words[0] == "run":
        right = None
    return BadInput("protocols", name, words, right, {"p.toml": text.encode("utf-8", "surrogateescape")})


_SAME: tuple[tuple[str, Callable[[str], str]], ...] = (
    ("comment", lambda text: "# [[[[ a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q.r\n" + text),
    ("windows", lambda text: text.replace("\n", "\r\n")),
    ("mark of byte order", lambda text: "\ufeff" + text),
    ("markup in titles", lambda text: text.replace("Unseen segment", "Seen [/unseen] segment")),
    ("unicode", lambda text: text.replace("Unseen segment", "未見 🖐 ↑")),
    ("unpublished", lambda text: text[: text.index("[[published]]")]),
    ("long title", lambda text: text.replace("Unseen segment", "Unseen " * 1000)),
)


def runs(rng: random.Random, bases: Bases) -> BadInput:
    """A run folder with a spoiled file, read by every verb that reads runs. Some records are sealed again, as by who
    wants them to be believed: their digests fit, and what they say must be refused, or shown as it stands."""
    files = sorted(
        path.relative_to(bases.run).as_posix()
        for path in (*bases.run.glob("*.json"), *bases.run.glob("cells/*"), *bases.run.glob("priors/*/train.json"))
    )
    report = [f"report/{name}" for name in (".inputs", "index.html")]
    verb = rng.choice((*_READERS, "query", "query", "query"))
    words = tuple(word.format(run="run", sound=bases.run) for word in _READERS[verb])
    right = _same_values(bases.values) if verb == "query" else None
    name = rng.choice([*files * 3, *report])
    if rng.random() < 0.08:
        return _special(rng, "runs", f"run/{name}", words, ("run", bases.run), f"{verb}: ")
    content = (bases.run / name).read_bytes()
    if name.endswith(".json") and rng.random() < 0.8:
        text = spoiled_json(rng, content.decode())
        if rng.random() < 0.7 and (forged := _sealed(text)) is not None:
            text, right = forged, None
        content = text.encode("utf-8", "surrogateescape")
    elif rng.random() < 0.3:
        content = _other_digit(rng, content)
    else:
        content = spoiled_bytes(rng, content)
    return BadInput("runs", f"{verb}: {name.split('/')[0]}", words, right, {f"run/{name}": content}, ("run", bases.run))


def _sealed(text: str) -> str | None:
    """A record with the digest of what it says now; None for what is no record any more."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return json.dumps(sealed(content)) if isinstance(content, dict) else None


_READERS = {
    "query": ("query", "{run}", VALUES, "--format", "json"),
    "report": ("report", "{run}"),
    "latex": ("report", "{run}", "--format", "latex"),
    "markdown": ("report", "{run}", "--format", "markdown"),
    "csv": ("report", "{run}", "--format", "csv"),
    "html": ("report", "{run}", "--format", "html"),
    "baseline": ("report", "{run}", "--baseline", "mean"),
    "gate": ("gate", "{run}", "--baseline", "{sound}"),
    "baseline of a gate": ("gate", "{sound}", "--baseline", "{run}", "--json"),
    "compare": ("compare", "{sound}", "{run}"),
    "several": ("report", "{run}", "{sound}"),
    "leaderboard": ("leaderboard", "board", "{run}"),
}


def pictures(rng: random.Random, bases: Bases) -> BadInput:
    """A pair of pictures of which one is spoiled, named wrong, or no regular file."""
    kinds = ("exr", "png", "npy")
    one, other = rng.choice(kinds), rng.choice(kinds)
    files = {name: bases.pictures[name] for name in (f"prediction.{one}", f"truth.{other}")}
    words = ["metrics", "compare", *files, "--only", "psnr", "--format", "csv"]
    spoiled = rng.choice(list(files))
    action = rng.randrange(8)
    right = None
    if action == 0:
        return _special(rng, "pictures", spoiled, tuple(words), files=files)
    if action == 1:
        right = _near(bases.psnr)
    elif action == 2:
        named = f"{spoiled.split('.')[0]}.{rng.choice(('exr', 'png', 'npy', 'jpg', 'hdr', 'txt', ''))}"
        words[words.index(spoiled)] = named
        files[named] = files.pop(spoiled)
        right = _near(bases.psnr)
    elif action == 3:
        files[spoiled] = files[spoiled][: rng.randrange(len(files[spoiled]))]
        right = _near(bases.psnr)
    else:
        files[spoiled] = spoiled_bytes(rng, files[spoiled], rng.choice((64, 400, None)))
    return BadInput("pictures", f"{spoiled.split('.')[1]} {action}", tuple(words), right, files)


def maps(rng: random.Random, bases: Bases) -> BadInput:
    """An environment map with a spoiled header or body."""
    name = rng.choice(list(bases.maps))
    content = bases.maps[name]
    if rng.random() < 0.1:
        return _special(rng, "maps", name, ("call:environment", name))
    if rng.random() < 0.3 and name == "m.hdr":
        content = content.replace(b"\n\n", b"\n" + rng.choice(_HDR_LINES) + b"\n\n", 1)
    elif rng.random() < 0.3 and name == "m.hdr":
        content = content.replace(b"-Y 8 +X 16", rng.choice(_HDR_SIZES), 1)
    else:
        content = spoiled_bytes(rng, content, rng.choice((60, 300, None)))
    return BadInput("maps", name, ("call:environment", name), None, {name: content})


_HDR_LINES = (b"EXPOSURE=0", b"EXPOSURE=nan", b"EXPOSURE=" + b"9" * 5000, b"COLORCORR=1 2", b"\xff\xfe", b"x" * 100_000)
_HDR_LINES += (b"FORMAT=nonsense", b"PRIMARIES=0 0 0 0 0 0 0 0", b"GAMMA=inf", b"PIXASPECT=-1", b"=", b"EXPOSURE=1e400")
_HDR_SIZES = (b"-Y 999999999 +X 999999999", b"-Y -8 +X 16", b"-Y 0 +X 0", b"+X 8", b"-Y 8 +X", b"-Y 1e3 +X 2e3", b"")
_HDR_SIZES += (b"-Y 9" + b"9" * 5000 + b" +X 16", b"-Y 16 +X 16", b"+Y 8 -X 16", b"-Y 8 +X 17")


def folders(rng: random.Random, bases: Bases) -> BadInput:
    """A prediction folder with a spoiled manifest or picture."""
    pictures = sorted(path.relative_to(bases.predictions).as_posix() for path in bases.predictions.glob("s*/**/*.exr"))
    name = rng.choice(["manifest.json"] * 3 + [rng.choice(pictures), "times.json"])
    files = {"p.toml": bases.protocol.encode()}
    tree, words = ("drawn", bases.predictions), ("call:score", "drawn")
    right = _same_values(bases.drawn) if name != rng.choice(pictures) and name.endswith("json") else None
    if rng.random() < 0.1:
        return _special(rng, "folders", f"drawn/{name}", words, tree, files=files)
    if name.endswith(".exr"):
        content = spoiled_bytes(rng, (bases.predictions / name).read_bytes(), rng.choice((400, None)))
    else:
        sound = bases.predictions / name
        content = spoiled_json(rng, sound.read_text() if sound.is_file() else _TIMES).encode("utf-8", "surrogateescape")
    return BadInput("folders", name.split("/")[0], words, right, {**files, f"drawn/{name}": content}, tree)


_TIMES = '{"device": "a GPU", "what": "relighting", "milliseconds": {"s01/pose-2/dorsal/group-0": 3.5}}'


def captures(rng: random.Random, bases: Bases) -> BadInput:
    """A light stage with a spoiled file."""
    files = sorted(path.relative_to(bases.capture).as_posix() for path in bases.capture.rglob("*") if path.is_file())
    name = rng.choice([*["capture.json"] * len(files), *["topology.npz"] * 20, *files])
    tree, words = ("stage", bases.capture), ("call:capture", "stage")
    if rng.random() < 0.05:
        return _special(rng, "captures", f"stage/{name}", words, tree)
    content = (bases.capture / name).read_bytes()
    if name.endswith(".json") and rng.random() < 0.8:
        content = spoiled_json(rng, content.decode()).encode("utf-8", "surrogateescape")
    else:
        content = spoiled_bytes(rng, content, rng.choice((400, None)))
    return BadInput("captures", name.split("/")[-1], words, None, {f"stage/{name}": content}, tree)


def commands(rng: random.Random, bases: Bases) -> BadInput:
    """A command line of a verb with odd words in it."""
    words = list(rng.choice(_COMMANDS))
    for i, word in enumerate(words):
        if word == "?":
            words[i] = rng.choice((*_ODD, *(text for text in HOSTILE_TEXTS if "\0" not in text)))
        elif word == "RUN":
            words[i] = str(bases.run)
    if rng.random() < 0.2:
        words.insert(rng.randrange(1, len(words) + 1), rng.choice(_ODD))
    return BadInput("commands", words[0], tuple(words))


_ODD = (
    "-1",
    "0",
    "1e999",
    "9" * 40,
    "nan",
    "--",
    "-",
    "--help",
    "/dev/null",
    "/",
    "",
    ",",
    "0,0",
    "1/0",
    "3/2",
    "cuda:99",
)
_ODD += (
    "\udcff",
    "'",
    '"',
    "%s%n",
    "{}",
    "$(x)",
    "/dev/full",
    "meta",
    "quick",
    "smoke",
    "psnr",
    "oracle",
    "*",
    "٣",
    "0x10",
)
_COMMANDS = (
    ("run", "?"),
    ("run", "smoke", "--methods", "absent", "--out", "?"),
    ("run", "smoke", "--methods", "absent", "--seeds", "?"),
    ("run", "smoke", "--methods", "absent", "--shard", "?"),
    ("run", "smoke", "--methods", "absent", "--device", "?"),
    ("run", "smoke", "--methods", "absent", "--executor", "?", "--cpus", "?"),
    ("run", "smoke", "--methods", "oracle", "--preset", "?"),
    ("check", "?", "--preset", "?"),
    ("check", "absent", "--protocol", "?"),
    ("report", "?", "--format", "?"),
    ("report", "RUN", "--baseline", "?"),
    ("report", "RUN", "--format", "csv", "--baseline", "?"),
    ("compare", "RUN", "?"),
    ("query", "RUN", "?"),
    ("query", "RUN", "SELECT now(), 1/0, 'nan'::DOUBLE, ?", "--format", "json"),
    ("query", "RUN", "SELECT * FROM read_csv('/etc/passwd')"),
    ("query", "RUN", "SELECT 'nan'::DOUBLE, 'inf'::DOUBLE, [1, NULL], {'a': 'nan'::FLOAT}", "--format", "json"),
    ("query", "RUN", "SELECT TIMESTAMPTZ '2020-01-01 00:00:00+00', DATE '-infinity', INTERVAL 1 YEAR", "--format", "?"),
    ("query", "?", "SELECT 1"),
    ("gate", "RUN", "--baseline", "?"),
    ("gate", "RUN", "--baseline", "RUN", "--quality", "?", "--time", "?"),
    ("gate", "RUN", "--baseline", "RUN", "--methods", "?", "--json"),
    ("audit", "?"),
    ("audit", "?", "--protocol", "?", "--json"),
    ("list", "?"),
    ("settings", "?"),
    ("settings", "urhand", "--preset", "?"),
    ("completion", "?"),
    ("data", "make", "?", "--size", "?", "--folder", "/dev/null"),
    ("data", "make", "openstage", "--size", "absent"),
    ("data", "show", "openstage", "--size", "mini", "--out", "/dev/null"),
    ("data", "show", "openstage", "--size", "mini", "--out", "absent/picture.png"),
    ("score", "?", "?"),
    ("score", "smoke", "absent", "--name", "?"),
    ("score", "smoke", "--template", "/dev/null"),
    ("geometry", "smoke", "--seed", "?", "--preset", "absent"),
    ("geometry", "?"),
    ("speed", "--methods", "absent"),
    ("speed", "--out", "/dev/null"),
    ("stress", "--methods", "absent", "--list"),
    ("stress", "--out", "/dev/null"),
    ("metrics", "compare", "?", "?", "--only", "?"),
    ("metrics", "compare", "RUN", "RUN", "--mask", "?"),
    ("?",),
)

FAMILIES: dict[str, tuple[Family, int]] = {
    "protocols": (protocols, 22),
    "runs": (runs, 30),
    "pictures": (pictures, 20),
    "maps": (maps, 8),
    "folders": (folders, 5),
    "captures": (captures, 10),
    "commands": (commands, 20),
    "surroundings": (surroundings, 4),
    "layouts": (lambda rng, bases: layouts(rng, bases.hands), 26),
    "formats": (lambda rng, bases: formats(rng, bases.hands), 16),
    "avatars": (lambda rng, bases: avatars(rng, bases.hands), 8),
    "verbs": (lambda rng, bases: verbs(rng, bases.hands), 16),
}
"""Families and their shares."""


def generate(count: int, seed: int, bases: Bases, only: str | None = None) -> list[BadInput]:
    """`count` cases, of every family as many as its share says; case i depends on the seed and i alone."""
    names = [only] if only else list(FAMILIES)
    shares = [FAMILIES[name][1] for name in names]
    order = random.Random(f"{seed}")
    chosen = order.choices(names, shares, k=count)
    return [FAMILIES[name][0](random.Random(f"{seed} {i}"), bases) for i, name in enumerate(chosen)]


def _special(
    rng: random.Random,
    family: str,
    name: str,
    words: tuple[str, ...],
    tree: tuple[str, Path] | None = None,
    prefix: str = "",
    files: dict[str, bytes] | None = None,
) -> BadInput:
    """What is no regular file, or endless, in the place of a file."""
    line = rng.choice(ENDLESS)
    made = f"rm -rf {name}; {line.format(name)}"
    kept = {key: content for key, content in (files or {}).items() if key != name}
    return BadInput(family, f"{prefix}{line.split()[0]}", words, None, kept, tree, made)


def _other_digit(rng: random.Random, content: bytes) -> bytes:
    """One digit of a file is another: still well formed, and wrong."""
    places = [i for i, byte in enumerate(content) if chr(byte).isdigit()]
    place = rng.choice(places) if places else 0
    return content[:place] + str((content[place] + rng.randrange(1, 9)) % 10).encode() + content[place + 1 :]


def _says(text: str) -> Callable[[str], bool]:
    return lambda out: out.strip() == text.strip()


def _near(value: float) -> Callable[[str], bool]:
    """Whether the values of a CSV of metrics, last on each line, are the right one."""

    def right(out: str) -> bool:
        found = [float(word) for line in out.splitlines()[1:] for word in line.split(",")[-1:] if _number(word)]
        plain = [float(line.split(",")[1]) for line in out.splitlines()[1:] if _number(line.split(",")[1])] or found
        return all(math.isclose(each, value, abs_tol=0.01) for each in plain[:1])

    return right


def _number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _same_values(sound: dict[str, float]) -> Callable[[str], bool]:
    """Whether every value that is told is the sound one: values may be missing, none may be another."""

    def right(out: str) -> bool:
        try:
            found = values(out)
        except ValueError:
            return False
        return all(key in sound and abs(sound[key] - value) < 1e-9 for key, value in found.items())

    return right
