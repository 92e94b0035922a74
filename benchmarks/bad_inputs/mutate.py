"""How sound files are spoiled."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from typing import Any

HOSTILE_TEXTS = (
    "",
    " ",
    "../../up",
    "/etc/passwd",
    "a/b",
    "a\x1b[31mred",
    "two\nlines\n\nand a blank one",
    "[/unseen] [bold]markup[/]",
    "<script>alert(1)</script>",
    "=1+1",
    r"\input{/etc/passwd}",
    "\u202eturned",
    "𝕌nicode 🖐 ↑",
    "x" * 10_000,
    "*?[a-z]",
    "NaN",
    "\x00",
)
HOSTILE_VALUES: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    2**63,
    10**400,
    1e308,
    -0.0,
    float("nan"),
    float("inf"),
    [],
    {},
    [[]],
    [None],
    {"a": {"b": {"c": 1}}},
    *HOSTILE_TEXTS,
    "\ud800",
)


def spoiled_bytes(rng: random.Random, content: bytes, head: int | None = None) -> bytes:
    """Bytes flipped, cut, doubled, put in or taken out, all over or in the first `head` bytes."""
    data, end = bytearray(content), min(len(content), head or len(content)) or 1
    for _ in range(rng.choice((1, 1, 2, 8))):
        place = rng.randrange(end)
        kind = rng.randrange(6)
        if kind == 0:
            data[place : place + 1] = bytes([rng.randrange(256)])
        elif kind == 1:
            data[place : place + 4] = rng.choice((b"\xff" * 4, b"\x00" * 4, b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f"))
        elif kind == 2:
            del data[place:]
        elif kind == 3:
            data[place:place] = rng.randbytes(rng.choice((1, 16, 300)))
        elif kind == 4:
            del data[place : place + rng.choice((1, 16, 300))]
        else:
            data[place : place + 1] = bytes([data[place % len(data)] ^ 1 << rng.randrange(8)]) if data else b"x"
        if not data:
            break
    return bytes(data)


def spoiled_json(rng: random.Random, content: str) -> str:
    """One or two values replaced, removed or renamed, or the text itself spoiled."""
    kind = rng.randrange(12)
    if kind == 0:
        return spoiled_bytes(rng, content.encode()).decode("utf-8", "surrogateescape")
    if kind == 1:
        return rng.choice(("", "null", "[]", "{}", "1e999", "[" * 100_000, '{"a":' * 900 + "1" + "}" * 900, "9" * 5000))
    value = json.loads(content)
    for _ in range(rng.choice((1, 1, 2))):
        places = list(_places(value))
        if not places:
            break
        owner, key = rng.choice(places)
        action = rng.randrange(5)
        if action == 0:
            del owner[key]
        elif action == 1 and isinstance(owner, dict):
            owner[rng.choice(HOSTILE_TEXTS)] = owner.pop(key)
        elif action == 2 and isinstance(owner[key], list | dict):
            owner[key] = [owner[key]] if rng.random() < 0.5 else type(owner[key])()
        else:
            owner[key] = rng.choice(HOSTILE_VALUES)
    return json.dumps(value)


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Every (container, key) below a value."""
    keys = value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in keys:
        yield value, key
        yield from _places(value[key])


def spoiled_toml(rng: random.Random, content: str) -> str:
    """A line removed, doubled, moved or given another value, or bytes spoiled."""
    lines = content.splitlines()
    for _ in range(rng.choice((1, 1, 2, 3))):
        place = rng.randrange(len(lines))
        kind = rng.randrange(7)
        if kind == 0:
            del lines[place]
        elif kind == 1:
            lines.insert(rng.randrange(len(lines)), lines[place])
        elif kind == 2:
            return spoiled_bytes(rng, content.encode()).decode("utf-8", "surrogateescape")
        elif kind == 3:
            lines.insert(place, rng.choice(_TOML_LINES))
        elif "=" in lines[place]:
            key = lines[place].partition("=")[0]
            lines[place] = f"{key}= {_toml(rng.choice(HOSTILE_VALUES))}"
    return "\n".join(lines)


_TOML_LINES = (
    "x = " + "[" * 900 + "]" * 900,
    ".".join("a" * 50_000) + " = 1",
    "version = " + "9" * 5000,
    "[[column]]",
    "[train]",
    "[published.values]",
    'title = """',
    "seeds = [18446744073709551616]",
    "limit = -1",
    '"\\u001b" = 1',
)


def _toml(value: Any) -> str:
    if value is None:
        return "1979-05-27T07:32:00Z"
    if isinstance(value, float):
        return {"nan": "nan", "inf": "inf"}.get(repr(value), repr(value))
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)
