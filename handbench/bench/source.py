"""A digest of the code behind a plug-in, found without running it.

It tells when a result must be computed anew because a method or a metric was edited. What import statements do
not reach is not in it: data files, code that is imported by a computed name, and other packages.
"""

from __future__ import annotations

import ast
import hashlib
import sys
from collections.abc import Iterator
from importlib.machinery import ModuleSpec
from pathlib import Path


def source_digest(target: str) -> str:
    """Hex SHA-256 of the code of "module:attribute" and of every module it reaches by import statements.

    Followed are modules of handbench and of the plug-in's own top-level package, no others. The code counts, not
    its comments or layout. Nothing is imported, so torch stays unloaded.
    """
    start = target.partition(":")[0]
    roots = {"handbench", start.partition(".")[0]}
    specs: dict[str, ModuleSpec | None] = {}
    texts: dict[str, str] = {}
    waiting = [start]
    while waiting:
        name = waiting.pop()
        if name in texts or name.partition(".")[0] not in roots:
            continue
        spec = _spec(name, specs)
        if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
            continue
        tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
        texts[name] = ast.dump(tree)
        package = name if spec.submodule_search_locations is not None else name.rpartition(".")[0]
        waiting += _imports(tree, package, specs)
    digest = hashlib.sha256(target.encode())
    for name in sorted(texts):
        digest.update(f"\0{name}\0{texts[name]}".encode())
    return digest.hexdigest()


def _imports(tree: ast.AST, package: str, specs: dict[str, ModuleSpec | None]) -> Iterator[str]:
    """The modules that import statements anywhere in a module name; `package` is what its relative imports mean.

    `from package import module` names the module alone: a package's table of plug-ins is not a plug-in's code.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join(above + ([base] if base else []))
            for alias in node.names:
                inner = f"{base}.{alias.name}"
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
