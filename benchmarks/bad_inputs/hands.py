"""Families about hands of one's own: folders, published layouts, files of each format, avatars, verbs on them."""

from __future__ import annotations

import random
from pathlib import Path

from .case import BadInput
from .mutate import HOSTILE_TEXTS, HOSTILE_VALUES, spoiled_bytes, spoiled_json, spoiled_toml
from .sound import Hands

ENDLESS = ("mkfifo {0}", "ln -s /dev/zero {0}", "mkdir {0}", "ln -s {0} {0}", "ln -s gone {0}", "truncate -s 1T {0}")


def layouts(rng: random.Random, hands: Hands) -> BadInput:
    """A folder of pictures, plain or published, with a spoiled file: opened, a frame read, conventions checked."""
    name = rng.choice(("plain", "plain", "plain", *hands.captures))
    sound = hands.captures[name]
    files = sorted(path.relative_to(sound).as_posix() for path in sound.rglob("*") if path.is_file())
    told = [file for file in files if not file.endswith((".png", ".jpg"))]
    file = rng.choice([*told * 3, *files] if name != "plain" else [*["handbench.toml"] * 30, *told * 3, *files])
    verb = ("data", "check", "hands", "--frames", "2", "--out", "s.png")
    words = verb if rng.random() < 0.15 else ("call:folder", "hands")
    if rng.random() < 0.08:
        line = rng.choice(ENDLESS)
        made = f"rm -rf hands/{file}; {line.format(f'hands/{file}')}"
        return _case(hands, "layouts", f"{name} {line.split()[0]}", words, {}, ("hands", sound), made)
    content = _spoiled(rng, file, (sound / file).read_bytes())
    kind = file.rpartition(".")[2]
    return _case(hands, "layouts", f"{name} {kind}", words, {f"hands/{file}": content}, ("hands", sound))


def formats(rng: random.Random, hands: Hands) -> BadInput:
    """A file of one format, spoiled: meshes, poses, cameras, cube maps, pictures, MANO's pickle."""
    name = rng.choice(list(hands.files))
    files = {key: content for key, content in hands.files.items() if key == name or key in _TOGETHER.get(name, ())}
    call = {
        "obj": "mesh",
        "ply": "mesh",
        "glb": "mesh",
        "npz": "poses",
        "json": "cameras",
        "txt": "cameras",
        "bin": "cameras",
    }
    call |= {"ktx": "environment", "pkl": "mano", "jpg": "picture", "avif": "picture", "png": "picture"}
    suffix = name.rpartition(".")[2]
    words = (f"call:{call[suffix]}", "." if suffix in ("txt", "bin") else name)
    if rng.random() < 0.08:
        line = rng.choice(ENDLESS)
        kept = {key: content for key, content in files.items() if key != name}
        return BadInput("formats", f"{suffix} {line.split()[0]}", words, None, kept, None, line.format(name))
    files[name] = _spoiled(rng, name, files[name])
    return BadInput("formats", suffix, words, None, files)


_TOGETHER = {
    f"{one}.{kind}": (f"{other}.{kind}",)
    for kind in ("txt", "bin")
    for one, other in (("cameras", "images"), ("images", "cameras"))
}


def avatars(rng: random.Random, hands: Hands) -> BadInput:
    """An avatar with a spoiled file, read and drawn, or exported."""
    files = sorted(path.relative_to(hands.avatar).as_posix() for path in hands.avatar.rglob("*") if path.is_file())
    file = rng.choice(["avatar.json"] * 6 + files)
    verbs = (("call:avatar", "a.avatar"),) * 6
    verbs += (("export", "a.avatar", "--out", "x.glb"),)
    words = rng.choice(verbs)
    if rng.random() < 0.08:
        line = rng.choice(ENDLESS)
        made = f"rm -rf a.avatar/{file}; {line.format(f'a.avatar/{file}')}"
        return BadInput("avatars", line.split()[0], words, None, {}, ("a.avatar", hands.avatar), made)
    content = _spoiled(rng, file, (hands.avatar / file).read_bytes())
    case = ("avatars", f"{words[0]} {file.rpartition('.')[2]}", words, None)
    return BadInput(*case, {f"a.avatar/{file}": content}, ("a.avatar", hands.avatar))


def verbs(rng: random.Random, hands: Hands) -> BadInput:
    """A command line of a verb on hands with odd words in it."""
    words = [_word(rng, hands, word) for word in rng.choice(_COMMANDS)]
    if rng.random() < 0.15 and words[0] != "view":
        words.insert(rng.randrange(1, len(words) + 1), rng.choice(_ODD))
    return _case(hands, "verbs", words[0], tuple(words), {})


def _case(
    hands: Hands,
    family: str,
    name: str,
    words: tuple[str, ...],
    files: dict[str, bytes],
    tree: tuple[str, Path] | None = None,
    special: str = "",
) -> BadInput:
    """A case in which MANO's files are there."""
    there = {"HANDBENCH_MANO": str(hands.mano)}
    return BadInput(family, name, words, None, files, tree, special, environment=there)


def _word(rng: random.Random, hands: Hands, word: str) -> str:
    if word == "?":
        return rng.choice((*_ODD, *(text for text in HOSTILE_TEXTS if "\0" not in text)))
    known = {"AVATAR": hands.avatar, "MINE": hands.captures["plain"], "MANO": hands.mano / "MANO_RIGHT.pkl"}
    known |= {"POSES": next(hands.captures["plain"].glob("poses/*.npz"))}
    known |= {"CAMERAS": hands.captures["plain"] / "transforms.json", "PICTURE": _picture(hands.captures["plain"])}
    for name, place in known.items():
        word = word.replace(name, str(place))
    return word


def _picture(folder: Path) -> Path:
    return next(folder.glob("images/*/*.png"))


_ODD = ("-1", "0", "1e999", "9" * 40, "nan", "--", "-", "/dev/null", "/", "", ",", "0x0", "24x", "1x1", "9999999x2")
_ODD += (
    "hall:rotate=nan",
    "hall:exposure=1e9",
    "hall:",
    ":clip",
    "front:yaw=",
    "front:zoom=0",
    "x:z-up,y-down",
    "rest",
)
_ODD += ("\udcff", "$(x)", "meta", "quick", "physical", "mano-right", "openhand", "absent.npz", "absent.json", "٣")
_RELIGHT = ("relight", "AVATAR", "--size", "24x32", "--out")
_SOUND: tuple[tuple[str, ...], ...] = (
    (*_RELIGHT, "o.png", "--light", "hall"),
    ("export", "AVATAR", "--out", "x.glb"),
    ("hand", "poses", "POSES", "--to", "mano-right", "--flat-hand-mean", "no", "--out", "x.npz"),
    ("data", "check", "MINE", "--frames", "1", "--out", "s.png"),
)
"""These are answered, unless an odd word is put in."""

_COMMANDS: tuple[tuple[str, ...], ...] = (
    *_SOUND,
    ("personalise", "?", "--from", "MINE", "--out", "x.avatar"),
    ("personalise", "physical", "--from", "?", "--out", "x.avatar"),
    ("personalise", "physical", "--from", "MINE", "--prior", "?", "--out", "x.avatar"),
    ("personalise", "mean-phone", "--from", "MINE", "--subject", "?", "--out", "x.avatar"),
    ("personalise", "mean-phone", "--from", "MINE", "--segment", "?", "--preset", "?", "--out", "x.avatar"),
    ("personalise", "uhm", "--from", "MINE", "--seed", "?", "--device", "?", "--out", "/dev/null"),
    ("personalise", "physical", "--run", "?", "--subject", "?", "--out", "x.avatar"),
    (*_RELIGHT, "o.png", "--light", "?"),
    (*_RELIGHT, "o.png", "--light", "hall", "--camera", "?"),
    (*_RELIGHT, "o.png", "--light", "hall", "--camera", "CAMERAS:frame=0,millimetres"),
    (*_RELIGHT, "o.png", "--light", "hall", "--camera", "CAMERAS:frame=99"),
    (*_RELIGHT, "o.gif", "--light", "hall", "--camera", "CAMERAS:millimetres"),
    (*_RELIGHT, "o.png", "--light", "hall", "--pose", "?"),
    (*_RELIGHT, "o.png", "--light", "hall", "--pose", "POSES", "--flat-hand-mean", "?"),
    (*_RELIGHT, "o.gif", "--light", "hall", "--turn-light", "--seconds", "?", "--fps", "?"),
    (*_RELIGHT, "o.gif", "--light", "hall", "--turn-light", "--seconds", "0.1", "--exposure", "?"),
    (*_RELIGHT, "/dev/null", "--light", "hall"),
    (*_RELIGHT, "absent/o.png", "--light", "hall"),
    (*_RELIGHT, "o.txt", "--light", "hall"),
    (*_RELIGHT, "o.exr", "--light", "hall", "--light", "park"),
    (*_RELIGHT, "o.png", "--light", "PICTURE"),
    (*_RELIGHT, "o.png", "--light", "hall", "--methods", "?"),
    ("relight", "AVATAR", "--light", "hall", "--out", "o.png", "--size", "?"),
    ("relight", "?", "--light", "hall", "--out", "o.png"),
    ("relight", "--run", "?", "--light", "hall", "--out", "o.png"),
    ("relight", "--light", "hall", "--out", "o.png"),
    ("view", "?"),
    ("view", "absent.avatar", "--port", "?"),
    ("view", "absent.avatar", "--size", "?"),
    ("view", "absent.avatar", "--light", "?"),
    ("view", "--run", "?", "--methods", "?"),
    ("export", "?", "--out", "x.glb"),
    ("export", "AVATAR", "--pose", "?", "--out", "x.glb"),
    ("export", "AVATAR", "--out", "/dev/null"),
    ("export", "AVATAR", "--out", "absent/x.glb"),
    ("hand", "poses", "?", "--to", "mano-right", "--out", "x.npz"),
    ("hand", "poses", "POSES", "--to", "?", "--out", "x.npz"),
    ("hand", "poses", "POSES", "--from", "?", "--to", "openhand", "--out", "x.npz"),
    ("hand", "poses", "MANO", "--to", "mano-right", "--flat-hand-mean", "no", "--out", "x.npz"),
    ("hand", "texture", "?", "--to", "mano-right", "--out", "x.exr"),
    ("hand", "texture", "PICTURE", "--to", "mano-right", "--size", "?", "--out", "x.exr"),
    ("data", "template", "?"),
    ("data", "check", "?"),
    ("data", "check", "MINE", "--frames", "?"),
    ("data", "check", "MINE", "--frames", "1", "--out", "/dev/null"),
    ("cache", "?"),
    ("leaderboard", "board", "?"),
)


def _spoiled(rng: random.Random, name: str, content: bytes) -> bytes:
    """A file's content, spoiled as its format allows."""
    suffix = name.rpartition(".")[2]
    if suffix == "json" and rng.random() < 0.85:
        return spoiled_json(rng, content.decode()).encode("utf-8", "surrogateescape")
    if suffix == "toml":
        return spoiled_toml(rng, content.decode()).encode("utf-8", "surrogateescape")
    if suffix in ("txt", "obj", "csv", "ply") and rng.random() < 0.6:
        return _other_word(rng, content)
    return spoiled_bytes(rng, content, rng.choice((64, 400, None)))


def _other_word(rng: random.Random, content: bytes) -> bytes:
    """One word of a text is another, or a line is gone."""
    lines = content.decode("latin-1").splitlines()
    place = rng.choice((rng.randrange(len(lines)), rng.randrange(min(8, len(lines)))))
    words = lines[place].split()
    if not words or rng.random() < 0.2:
        del lines[place]
    else:
        words[rng.randrange(len(words))] = str(rng.choice(HOSTILE_VALUES))[:200]
        lines[place] = " ".join(words)
    return "\n".join(lines).encode("utf-8", "surrogatepass")
