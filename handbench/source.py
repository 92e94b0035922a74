"""A digest of what a plug-in is made of, its code and its data files, found without running it.

It tells when a result must be computed anew because a method or a metric was edited or got other weights. What is
not in it: code that is imported by a computed name, other packages, and files outside the plug-in's own package.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib.machinery import ModuleSpec
from pathlib import Path

from .cache import cache_folder
from .errors import InputError
from .files import whole

_CODE = {".py", ".pyc", ".pyi"}
_SETTLED = 2.0  # seconds after which a file's times tell its next change


def source_digest(target: str) -> str:
    """Hex SHA-256 of the code of "module:attribute", of all modules it reaches by import statements, and of their data.

    Followed are modules of handbench and of the plug-in's own top-level package, no others. The code counts, not
    its comments or layout. A module's data are the other files in the folder of its package, and in folders there
    that are no packages themselves (`weights/`); of a module outside a package, only `weights/` beside it. Nothing
    is imported, so torch stays unloaded.
    """
    return source_digests([target])[target]


def source_digests(targets: Iterable[str]) -> dict[str, str]:
    """`source_digest` of several targets, each file read once."""
    modules, digests = _Modules(), dict[str, str]()
    with _Digests() as files:
        for target in targets:
            digests[target] = digests.get(target) or _digest(target, modules, files)
    return digests


def _digest(target: str, modules: _Modules, files: _Digests) -> str:
    start = target.partition(":")[0]
    roots = {"handbench", start.partition(".")[0]}
    reached: dict[str, _Module] = {}
    waiting = [start]
    while waiting:
        name = waiting.pop()
        if name in reached or name.partition(".")[0] not in roots:
            continue
        module = modules.get(name)
        if module is not None:
            reached[name] = module
            waiting += module.imports
    digest = hashlib.sha256(target.encode())
    for name in sorted(reached):
        digest.update(f"\0{name}\0{reached[name].code}".encode())
    for line in sorted(_data_lines({module.data for module in reached.values()}, files)):
        digest.update(f"\0{line}".encode())
    return digest.hexdigest()


@dataclass(frozen=True)
class _Module:
    """A module's code without comments and layout, the modules it imports, and the folder of its data."""

    code: str
    imports: tuple[str, ...]
    data: Path


class _Modules:
    """Modules by name, read when they are asked for."""

    def __init__(self) -> None:
        self._found: dict[str, _Module | None] = {}
        self._specs: dict[str, ModuleSpec | None] = {}

    def get(self, name: str) -> _Module | None:
        """None for a module that is not there or has no source."""
        if name not in self._found:
            self._found[name] = self._read(name)
        return self._found[name]

    def _read(self, name: str) -> _Module | None:
        spec = _spec(name, self._specs)
        if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
            return None
        path = Path(spec.origin)
        code, imports = _parsed(path.read_text(encoding="utf-8"))
        package = name if spec.submodule_search_locations is not None else name.rpartition(".")[0]
        named = dict.fromkeys(name for each in imports for name in _named(each, package, self._specs))
        return _Module(code, tuple(named), path.parent if package else path.with_name("weights"))


def _data_lines(folders: set[Path], files: _Digests) -> Iterator[str]:
    """Name and digest of each data file; places on disk are not in it."""
    for folder in folders:
        for path in _data_files(folder):
            yield f"{folder.name}/{path.relative_to(folder).as_posix()} {files.of(path)}"


def _data_files(folder: Path, above: tuple[str, ...] = ()) -> Iterator[Path]:
    """The files of a folder that are no code, and those of its folders that are no packages; no hidden ones."""
    real = os.path.realpath(folder)
    if real in above or not folder.is_dir():  # a link may lead back up
        return
    for path in folder.iterdir():
        if path.name.startswith((".", "__pycache__")):
            continue
        if path.is_dir():
            if not (path / "__init__.py").exists():
                yield from _data_files(path, (*above, real))
        elif path.is_file() and path.suffix not in _CODE:
            yield path


class _Digests:
    """Digests of files, remembered on this machine by size and times, so that large weights are read once."""

    def __init__(self) -> None:
        self._kept = cache_folder() / "digests.json"
        self._known: dict[str, list[int | str]] = {}
        self._new = False

    def __enter__(self) -> _Digests:
        with suppress(OSError, ValueError):
            known = json.loads(self._kept.read_text(encoding="utf-8"))
            self._known = known if isinstance(known, dict) else {}
        return self

    def __exit__(self, *error: object) -> None:
        if self._new:
            with suppress(OSError):  # without it the files are read again
                self._kept.parent.mkdir(parents=True, exist_ok=True)
                with whole(self._kept) as part:
                    part.write_text(json.dumps(self._known, indent=0), encoding="utf-8")

    def of(self, path: Path) -> str:
        """Hex SHA-256 of a file's content."""
        name, found = os.path.realpath(path), path.stat()
        stamp = [found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino]
        match self._known.get(name):
            case [*kept, str(digest)] if kept == stamp:
                return digest
        try:
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise InputError(f"data file {path} of a plug-in cannot be read ({error.strerror}); remove it") from error
        if time.time() - max(found.st_mtime, found.st_ctime) > _SETTLED:
            self._known[name] = [*stamp, digest]
            self._new = True
        return digest


@dataclass(frozen=True)
class _Import:
    """An import statement: `from base import names`, `level` dots before the base; `import base` has no names."""

    base: str
    level: int = 0
    names: tuple[str, ...] = ()


@lru_cache(maxsize=1024)
def _parsed(text: str) -> tuple[str, tuple[_Import, ...]]:
    """A module's code without comments and layout, and its import statements, wherever they stand."""
    tree, found = ast.parse(text), list[_Import]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += (_Import(alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            found.append(_Import(node.module or "", node.level, tuple(alias.name for alias in node.names)))
    return ast.dump(tree), tuple(found)


def _named(found: _Import, package: str, specs: dict[str, ModuleSpec | None]) -> Iterator[str]:
    """The modules that an import statement names; `package` is what a relative one means.

    `from package import module` names the module alone: a package's table of plug-ins is not a plug-in's code.
    """
    base = found.base
    if found.level:
        above = package.split(".")[: len(package.split(".")) - found.level + 1]
        base = ".".join(above + ([base] if base else []))
    if not found.names:
        yield base
    for name in found.names:
        inner = f"{base}.{name}"
        yield inner if _spec(inner, specs) else base


def _spec(name: str, known: dict[str, ModuleSpec | None]) -> ModuleSpec | None:
    """Where a module's file is; unlike `importlib.util.find_spec` this imports no parent package."""
    if name not in known:
        parent = name.rpartition(".")[0]
        path = None
        if parent:
            above = _spec(parent, known)
            path = None if above is None else above.submodule_search_locations
        found = None
        if not parent or path is not None:
            specs = (finder.find_spec(name, path) for finder in sys.meta_path if hasattr(finder, "find_spec"))
            found = next((spec for spec in specs if spec is not None), None)
        known[name] = found
    return known[name]
