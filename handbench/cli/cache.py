"""handbench cache: what is kept on disk, how large it is, and how to be rid of it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..terminal import say
from .shared import examples, json_option, tell

if TYPE_CHECKING:
    from ..keeping import Kept


def add(verbs: Any) -> None:
    cache = verbs.add_parser("cache", help="what is kept on disk, how large it is; remove it")
    cache.add_argument("what", nargs="*", help="names that 'handbench cache' lists, or run folders")
    cache.add_argument(
        "--clean", action="store_true", help="remove what is named; of a run folder only what its plan does not need"
    )
    json_option(cache)
    examples(
        cache,
        "cache  # captures, shadows and digests, with their sizes",
        "cache runs/quick  # the parts of a run folder, and what earlier plans left there",
        "cache runs/quick --clean  # remove these leavings",
        "cache shadows --clean  # remove an entry of the cache; it is made again when it is needed",
    )
    cache.set_defaults(verb=_cache)


def _cache(arguments: argparse.Namespace) -> int:
    from .. import keeping
    from ..errors import InputError

    if arguments.clean and not arguments.what:
        raise InputError("--clean removes what you name; 'handbench cache' lists the names")
    runs = {name: keeping.in_run(Path(name)) for name in arguments.what if keeping.is_run(name)}
    named = [name for name in arguments.what if name not in runs]
    kept = keeping.in_cache()
    entries = keeping.entries_named(named, kept) if arguments.what else kept
    freed = 0
    if arguments.clean:
        paths = [path for each in entries for path in each.paths]
        freed = keeping.remove([*paths, *(path for parts in runs.values() for part in parts for path in part.left)])
    if arguments.json:
        _tell(entries, runs, freed)
    elif arguments.clean:
        say(f"{keeping.bytes_told(freed)} removed")
    else:
        _say(entries, runs, whole=not arguments.what)
    return 0


def _say(entries: list[Kept], runs: dict[str, list[Kept]], whole: bool) -> None:
    from ..cache import cache_folder
    from ..keeping import bytes_told

    if whole:
        say(f"{cache_folder()}: {bytes_told(sum(each.bytes for each in entries))}")
    width = max((len(each.name) for each in entries), default=0)
    for each in entries:
        say(f"  {each.name:<{width}}  {bytes_told(each.bytes):>8}  {each.what}")
    for name, parts in runs.items():
        say(f"{name}: {bytes_told(sum(part.bytes for part in parts))}")
        for part in parts:
            left = f"; {bytes_told(part.left_bytes)} in {len(part.left)} left by earlier plans" if part.left else ""
            say(f"  {part.name:<11}  {bytes_told(part.bytes):>8}  {part.what}{left}")


def _tell(entries: list[Kept], runs: dict[str, list[Kept]], freed: int) -> None:
    from ..cache import cache_folder

    def plain(each: Kept) -> dict[str, Any]:
        return {"name": each.name, "what": each.what, "bytes": each.bytes, "left_bytes": each.left_bytes}

    of_runs = {name: list(map(plain, parts)) for name, parts in runs.items()}
    tell({"folder": str(cache_folder()), "cache": list(map(plain, entries)), "runs": of_runs, "removed": freed})
